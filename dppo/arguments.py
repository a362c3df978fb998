"""Arguments of `dppo` that have no flag: they stand anywhere among the flags."""

from typing import Annotated

from tyro.conf import Positional, arg

RunFolder = Annotated[str, Positional, arg(metavar="RUN")]
ExperimentFolder = Annotated[str, Positional, arg(metavar="DIR")]
GridFile = Annotated[str, Positional, arg(metavar="GRID.toml")]
