"""A learner that is killed with SIGKILL at one place of its code, so that each kill is the same.

DPPO_TRAP is `function event count`, e.g. `Chief._apply return 30`: the end comes when that
function returns for the 30th time. The interpreter's profiler tells; nothing of the learner is
changed.
"""

import os
import signal
import sys
from types import FrameType

from learner.__main__ import main

_function, _event, _count = os.environ["DPPO_TRAP"].split()
_left = int(_count)


def trap(frame: FrameType, event: str, _arg: object) -> None:
    """Called at every call and return in the main thread."""
    global _left
    if event != _event or frame.f_code.co_qualname != _function:
        return
    _left -= 1
    if _left == 0:
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    sys.setprofile(trap)
    main()
