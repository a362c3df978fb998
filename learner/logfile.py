"""The learner's log lines in the run directory: log.txt."""

import logging
from pathlib import Path

from learner.disk import Disk


class FileHandler(logging.Handler):
    """Log lines to a file, in a thread of its own: no line waits for the disk, none is torn."""

    def __init__(self, path: Path) -> None:
        super().__init__(logging.INFO)
        self._disk = Disk(path.parent, "")  # when it fails, the other files' warning says so
        size = path.stat().st_size if path.exists() else 0
        self._file = self._disk.file(path.name, size)

    def emit(self, record: logging.LogRecord) -> None:
        """Take one line."""
        try:
            self._file.write((self.format(record) + "\n").encode(errors="replace"))
        except Exception:
            self.handleError(record)  # as every handler: a bad line ends no run

    def settle(self) -> None:
        """Wait, not for long, until the lines are written."""
        self._disk.settle()


def log_to_file(path: Path) -> FileHandler:
    """Log lines go to the run directory, too."""
    handler = FileHandler(path)
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    root = logging.getLogger()
    for console in root.handlers:
        console.setLevel(root.level)
    root.addHandler(handler)
    root.setLevel(logging.INFO)
    return handler
