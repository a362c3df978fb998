"""`python -m tests.odd_child`: a child process that prints, reads, is silent or dies, as told."""

import os
import sys

import numpy as np

from dppo.children import Parent
from dppo.process import leave


def _work() -> int:
    parent = Parent()
    match parent.task["do"]:
        case "chatter":
            sys.stdout.write("said on stdout\n")
            os.write(1, b"and past Python\n")
            parent.answer({"read": sys.stdin.read()})
        case "measure":
            length = parent.task["length"]
            arrays = {
                "third": np.full(length, 1 / 3),
                "square": np.arange(4, dtype=np.int16).reshape(2, 2).T.copy(),
            }
            parent.answer({"pi": np.pi, "name": "ψ"}, arrays)
            parent.answer({})
        case "die":
            parent.answer({"half": 1})
            os._exit(0)
        case "wait":
            parent.answer({"ready": True})
            parent.wait_for_go()
            parent.answer({"gone": True})
    parent.finish()
    return 0


if __name__ == "__main__":
    leave(_work)
