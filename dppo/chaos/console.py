"""The outcome of a drill as tables and sentences."""

from pathlib import Path

from rich.console import Console
from rich.table import Table

from dppo.chaos.outcome import Outcome

_WIDTH = 120
"""Where there is no terminal."""


def show(quiet: Outcome, disturbed: Outcome, folder: Path) -> None:
    """Print what came of it."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_WIDTH)
    if disturbed.faults:
        console.print(_faults(disturbed))
    if disturbed.growth:
        console.print(_growth(disturbed))
    for line in _sentences(quiet, disturbed):
        console.print(line, soft_wrap=True, markup=False)
    console.print(f"see {folder}", soft_wrap=True, markup=False)


def _faults(disturbed: Outcome) -> Table:
    table = Table(title="faults")
    for heading in ("iteration", "fault", "target", "lasts [s]", "next after [s]", "lost [s]"):
        table.add_column(heading, justify="left" if heading in ("fault", "target") else "right")
    table.add_column("remark")
    for record in disturbed.faults:
        after = record.recovered
        table.add_row(
            str(record.iteration),
            record.fault.fault,
            record.fault.target,
            f"{record.fault.seconds:g}" if record.fault.seconds else "",
            "never" if after is None else f"{after:.2f}",
            "" if after is None else f"{max(0.0, after - disturbed.median):.2f}",
            record.said,
        )
    return table


def _growth(disturbed: Outcome) -> Table:
    table = Table(title="growth per hour of processes that lived for minutes")
    for heading in ("process", "seen for [s]", "RSS [MB]", "RSS [MB/h]", "fds [1/h]", "threads"):
        table.add_column(heading, justify="left" if heading == "process" else "right")
    for one in disturbed.growth:
        table.add_row(
            one.name,
            f"{one.seconds:.0f}",
            f"{one.rss_mb:.0f}",
            f"{one.rss_mb_per_hour:+.1f}",
            f"{one.fds_per_hour:+.1f}",
            f"{one.threads_per_hour:+.1f}",
        )
    return table


def _sentences(quiet: Outcome, disturbed: Outcome) -> list[str]:
    lines = [
        f"undisturbed  {quiet.iterations} iterations in {quiet.seconds:.1f} s, "
        f"{quiet.median:.3f} s each, {quiet.sha256 or 'no hash'}",
        f"disturbed    {disturbed.iterations} iterations in {disturbed.seconds:.1f} s, "
        f"{disturbed.median:.3f} s each, {disturbed.sha256 or 'no hash'}; "
        f"{len(disturbed.faults)} faults, {disturbed.restarts} restarts of the learner",
    ]
    if disturbed.problem:
        lines.append(f"FAILED: {disturbed.problem}")
    elif quiet.sha256 == disturbed.sha256:
        lines.append("same bits")
    elif disturbed.exact:
        lines.append("OTHER BITS: the hashes differ, and the run says that it is exact")
    else:
        lines.append("the hashes differ, as they may: the run says that it is not exact")
    left = "; ".join(disturbed.left_behind) or "nothing"
    lines.append(f"left behind: {left}")
    return lines
