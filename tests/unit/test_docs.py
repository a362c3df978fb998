"""What the documents point to exists, and what they promise is in the program's help."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
