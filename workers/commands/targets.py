"""Files that a command is to write, looked at before it works for them."""

from pathlib import Path

from dppo.errors import UsageError


def check_targets(*files: str) -> None:
    """Refuse names that no file, or not each of these, can be written under.

    Raises:
        UsageError: a name is a folder's, or lies in no folder, or two are the same file.
    """
    for file in files:
        if Path(file).is_dir():
            raise UsageError(f"{file} is a folder, expected a file to write; give a file's name")
        if not Path(file).absolute().parent.is_dir():
            raise UsageError(f"{file} lies in no folder that exists; make the folder first")
    if len({Path(file).resolve() for file in files}) < len(files):
        raise UsageError(
            f"{' and '.join(files)} are the same file, expected one of its own for each; give "
            "different names"
        )
