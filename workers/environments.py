"""`python -m workers.environments`: can these environments be made? For `dppo experiment`."""

import json
import sys


def main() -> None:
    """Make each of the environments of a JSON list [[id, keyword arguments as JSON], ...]."""
    from dppo.machine import no_window, one_thread
    from dppo.process import leave

    one_thread()
    no_window()
    leave(_work)


def _work() -> int:
    from dppo.config import RunConfig
    from workers.envs import make_env, quiet, spaces_of

    quiet()
    for env, kwargs in json.loads(sys.argv[1]):
        made = make_env(RunConfig(env=env, env_kwargs=kwargs))
        spaces_of(made)
        made.close()
    return 0


if __name__ == "__main__":
    main()
