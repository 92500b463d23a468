"""Options of commands that read records: units, names of columns, time."""

from collections.abc import Callable
from typing import TypeVar, get_args

import click

from casid.record import Hold

T = TypeVar("T")


def pairs(
    read: Callable[[str], T],
) -> Callable[[click.Context, click.Parameter, tuple[str, ...]], dict[str, T]]:
    """What click calls to make a mapping of ``name=value``, values as ``read`` reads them."""

    def made(_: click.Context, option: click.Parameter, values: tuple[str, ...]) -> dict[str, T]:
        found = {}
        for value in values:
            name, equals, other = value.partition("=")
            try:
                found[name] = read(other)
            except ValueError:
                equals = ""
            if not equals or not other:
                raise click.BadParameter(f"{value!r}: expected {option.metavar}", param=option)
        return found

    return made


UNIT = click.option(
    "--unit",
    "units",
    multiple=True,
    callback=pairs(str),
    metavar="CHANNEL=UNIT",
    help="Unit of a column that is not in SI, such as p=deg/s or lat=%; may be repeated.",
)
COLUMN = click.option(
    "--column",
    "renamed",
    multiple=True,
    callback=pairs(str),
    metavar="CHANNEL=COLUMN",
    help="Column that holds a channel under another name, such as p=ROLL_RATE; may be repeated.",
)
MODEL = click.option(
    "--model", "structure", metavar="MODEL.py:CLASS", help="Structure, models/six_dof.py:SixDof."
)
HOLD = click.option(
    "--hold",
    type=click.Choice(get_args(Hold)),
    help="What inputs do between samples: as in the records of the fit, else foh.",
)
TIME_COLUMN = "t"
TIME = click.option("--time", default=TIME_COLUMN, show_default=True, help="Column of instants.")


def refuse_beside_study(**given: object) -> None:
    """ValueError for options of records that were given beside a study, which has its own."""
    options = [f"--{name}" for name, value in given.items() if value]
    if options:
        raise ValueError(
            f"{', '.join(options)} cannot be given with a study, which itself states records, "
            "channels, units and fixed parameters; name it alone and change it there, or name a "
            "model (MODEL.py:CLASS) or records instead"
        )
