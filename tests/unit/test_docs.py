"""What the documents point to exists, and what they promise is in the program's help."""

import re
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from dppo.config import Config
from learner.__main__ import _ALIASES, ProcessArgs

ROOT = Path(__file__).parents[2]
DOCUMENTS = (
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "deploy" / "README.md",
    ROOT / "benchmarks" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
)


def prose(document):
    """The text without its blocks of code: a `[a](b)` in there is no link."""
    return re.sub(r"^```.*?^```", "", document.read_text(), flags=re.MULTILINE | re.DOTALL)


def relative_targets(document):
    """What links and images point to inside this repository."""
    targets = re.findall(r"\]\(<?([^)>\s]+)", prose(document))
    targets += re.findall(r"^\[[^\]]+\]:\s*(\S+)", prose(document), flags=re.MULTILINE)
    files = (target.partition("#")[0] for target in targets)
    return [file for file in files if file and not re.match(r"[a-z]+:", file)]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_relative_link_points_to_something(document):
    missing = [
        target for target in relative_targets(document) if not (document.parent / target).exists()
    ]
    assert missing == []


def test_the_readme_has_links_for_the_test_above():
    assert "docs/design.md" in relative_targets(ROOT / "README.md")


def flags_in_tables(document):
    """Every `--flag` in the rows of the document's tables."""
    rows = [line for line in prose(document).splitlines() if line.startswith("|")]
    return set(re.findall(r"--[a-z][a-z-]*", "\n".join(rows)))


def test_every_flag_in_the_readme_tables_is_in_the_learner_help():
    command = [sys.executable, "-m", "learner", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    in_help = set(re.findall(r"--[a-z][a-z-]*", done.stdout))
    in_tables = flags_in_tables(ROOT / "README.md")
    assert {"--psi", "--seed", "--slots"} <= in_tables
    assert in_tables - in_help == set()


DEFAULTS = {
    name.replace("_", "-"): value
    for group in (*asdict(Config()).values(), asdict(ProcessArgs()))
    for name, value in group.items()
}
IN_WORDS = {"one per core, at most W": -1}
"""See test_local_workers."""


def number_or_word(text):
    """What a cell says is the default: `-1: as λ` is -1."""
    if text in IN_WORDS:
        return IN_WORDS[text]
    first = text.strip("`").partition(":")[0]
    try:
        return float(first.replace(",", ""))
    except ValueError:
        return first


def test_every_default_in_the_readme_tables_is_the_programs():
    told: dict[str, Any] = {}
    rows = re.findall(r"^\| (`--.*) \|$", prose(ROOT / "README.md"), flags=re.MULTILINE)
    for flags, _, default, *_ in (map(str.strip, row.split("|")) for row in rows):
        names = re.findall(r"--([a-z-]+)", flags)
        defaults = default.split(", ") if len(names) > 1 else [default]
        told |= dict(zip(names, map(number_or_word, defaults), strict=True))
    assert told == {name: DEFAULTS[name] for name in told}
    assert len(told) > 20


def test_the_readme_names_the_aliases_that_there_are():
    _, _, after = prose(ROOT / "README.md").partition("\nNames from other trainers")
    named = set(re.findall("`(-[^`]*)`", after.partition("\n\n")[0]))
    assert set(_ALIASES) <= named
    assert {name.removeprefix("--") for name in named - set(_ALIASES)} <= set(DEFAULTS)


RELIABILITY = ROOT / "docs" / "reliability.md"
TEST_NAME = re.compile(r"`(\w+)/(test_\w+)::(test_\w+)`")
"""Folder and file below tests/, and the function."""
UNTESTED = [39]
"""Scenarios with a reason in place of a test: there are no certificates yet."""


def test_every_test_that_a_promise_rests_on_exists():
    named = sorted(set(TEST_NAME.findall(prose(RELIABILITY))))
    assert len(named) > 80
    missing = []
    for folder, file, test in named:
        path = ROOT / "tests" / folder / f"{file}.py"
        if not path.exists() or f"\ndef {test}(" not in path.read_text():
            missing.append(f"{folder}/{file}::{test}")
    assert missing == []


def test_every_mention_of_a_test_is_in_the_form_that_is_looked_up():
    text = prose(RELIABILITY)
    assert text.count("::test_") == len(TEST_NAME.findall(text))


def test_every_fault_scenario_has_its_line_with_a_test():
    lines = re.findall(r"^\| (\d+) \|(.*)\|$", prose(RELIABILITY), flags=re.MULTILINE)
    assert [int(number) for number, _ in lines] == list(range(1, 52))
    assert [int(number) for number, line in lines if not TEST_NAME.search(line)] == UNTESTED


def test_every_flag_that_operators_are_told_of_exists():
    told = flags_in_tables(RELIABILITY)
    sources = (ROOT / "learner" / "__main__.py", ROOT / "workers" / "__main__.py")
    words = "".join(path.read_text() for path in (*sources, ROOT / "dppo" / "settings.py"))
    missing = [flag for flag in told if f"    {flag[2:].replace('-', '_')}: " not in words]
    assert missing == []
    assert {"--patience", "--drop", "--restarts"} <= told
