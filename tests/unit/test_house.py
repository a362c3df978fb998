"""The house rules that a machine can hold us to."""

import ast
import importlib
import re
import subprocess
import sys
from functools import reduce
from pathlib import Path

import pytest

import dppo
import learner
import workers

ROOT = Path(__file__).parents[2]
PACKAGES = ("dppo", "learner", "workers")
FOLDERS = (*PACKAGES, "tests", "benchmarks")
FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
TREES = {str(path.relative_to(ROOT)): ast.parse(path.read_bytes()) for path in FILES}
EXECUTING = {"pickle", "cPickle", "shelve", "marshal", "dill", "cloudpickle", "joblib"}
"""Modules whose files run code when they are read."""
MOST_LINES, MOST_STATEMENTS = 300, 40


def test_no_file_is_longer_than_300_lines():
    lengths = {str(path.relative_to(ROOT)): len(path.read_bytes().splitlines()) for path in FILES}
    assert {name: lines for name, lines in lengths.items() if lines > MOST_LINES} == {}


def test_no_function_has_more_than_40_statements():
    long = {
        f"{name}:{function.lineno} {function.name}": statements
        for name, tree in TREES.items()
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        and (statements := sum(isinstance(node, ast.stmt) for node in ast.walk(function)) - 1)
        > MOST_STATEMENTS
    }
    assert long == {}


def imported(tree):
    """Top-level names of all modules a file imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            yield (node.module or "").split(".")[0]


def test_nothing_imports_what_may_execute_a_file():
    found = {name: EXECUTING & set(imported(tree)) for name, tree in TREES.items()}
    assert {name: bad for name, bad in found.items() if bad} == {}


def test_nothing_is_pickled_between_our_own_processes():
    """Benchmarks and tests may; what users run does not."""
    found = [
        f"{name}:{node.lineno}"
        for name, tree in TREES.items()
        if name.startswith(tuple(f"{package}/" for package in PACKAGES))
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        if {"multiprocessing", "_pickle"} & set(imported(node))
        or any(alias.name == "ProcessPoolExecutor" for alias in node.names)
    ]
    assert found == []


def test_no_array_is_loaded_with_leave_to_execute():
    found = [
        f"{name}:{node.value.lineno}"
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.keyword)
        if node.arg == "allow_pickle" or (node.arg == "weights_only" and _is_false(node.value))
    ]
    assert found == []


def _is_false(node):
    return isinstance(node, ast.Constant) and node.value is False


def test_every_module_says_what_it_is():
    silent = [name for name, tree in TREES.items() if tree.body and not ast.get_docstring(tree)]
    assert silent == []


@pytest.mark.parametrize("package", [dppo, learner, workers])
def test_generic_package_names_are_ours(package):
    assert Path(package.__file__) == ROOT / package.__name__ / "__init__.py"


def test_packages_may_only_import_whom_they_may():
    lint = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


CALENDARS = {
    "dppo/chaos/command.py": 1,  # name of a new folder
    "dppo/experiment/command.py": 1,  # for people, when it was started
    "dppo/store/run_directory.py": 1,  # name of a new folder
    "learner/runlog.py": 2,  # columns for people
}
"""Who asks what time of day it is, how often: nothing is decided by it."""


def test_no_decision_looks_at_a_clock_that_may_be_set():
    """Clocks of two hosts differ, and jump: durations come from clocks that only go on."""
    wall = {"time", "time_ns", "localtime", "gmtime", "now", "today", "utcnow", "fromtimestamp"}
    of_files = {"st_mtime", "st_mtime_ns", "st_ctime", "getmtime", "CLOCK_REALTIME"}
    found = {
        name: asked
        for name, tree in TREES.items()
        if name.startswith(PACKAGES)
        if (asked := sum(_names(node, wall, of_files) for node in ast.walk(tree)))
    }
    assert found == CALENDARS


def _names(node, wall, of_files):
    """Does this node name a wall clock, or a file's time?"""
    if isinstance(node, ast.ImportFrom):
        return node.module == "time"
    if not isinstance(node, ast.Attribute):
        return False
    owner = node.value.id if isinstance(node.value, ast.Name) else ""
    return node.attr in of_files or (owner in {"time", "datetime", "date"} and node.attr in wall)


ENTRY = re.compile(r"`([a-z_]\w*(?:\.\w+)*):([A-Za-z_]\w*(?:\.\w+)*)`")
ALGORITHM = ROOT / "docs" / "algorithm.md"


def test_every_place_in_the_table_of_the_algorithm_exists():
    entries = sorted(set(ENTRY.findall(ALGORITHM.read_text())))
    assert entries, "docs/algorithm.md names no `module:attribute`"
    missing = []
    for module, attribute in entries:
        try:
            reduce(getattr, attribute.split("."), importlib.import_module(module))
        except (ImportError, AttributeError) as error:
            missing.append(f"{module}:{attribute}: {error}")
    assert missing == []
