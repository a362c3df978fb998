"""`python -m workers.bench_process`: steps an environment for `bench.py`; not for people."""


def main() -> None:
    """Step when all are ready to, and answer how fast it went."""
    from dppo.machine import no_window, one_thread
    from dppo.process import leave

    one_thread()
    no_window()
    leave(_work)


def _work() -> int:
    from dppo.children import Parent

    parent = Parent()  # before what takes long to load
    from workers.bench import stepped
    from workers.envs import quiet

    quiet()
    parent.answer({"ready": True})
    parent.wait_for_go()
    speed, _ = stepped(**parent.task)
    parent.answer({"speed": speed})
    parent.finish()
    return 0


if __name__ == "__main__":
    main()
