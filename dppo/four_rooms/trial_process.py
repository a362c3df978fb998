"""`python -m dppo.four_rooms.trial_process`: some trials, for `processes.py`; not for people."""


def main() -> None:
    """Learn what the parent asks for."""
    from dppo.machine import one_thread
    from dppo.process import leave

    one_thread()
    leave(_work)


def _work() -> int:
    from dppo.children import Parent

    parent = Parent()  # before what takes long to load
    from dppo.four_rooms.processes import serve

    serve(parent)
    return 0


if __name__ == "__main__":
    main()
