"""Options of commands that read records: units, names of columns, time."""

import click


def _pairs(_: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for value in values:
        name, equals, other = value.partition("=")
        if not equals or not other:
            raise click.BadParameter(f"{value!r}: expected {parameter.metavar}")
        found[name] = other
    return found


UNIT = click.option(
    "--unit",
    "units",
    multiple=True,
    callback=_pairs,
    metavar="CHANNEL=UNIT",
    help="Unit of a column that is not in SI, such as p=deg/s or lat=%; may be repeated.",
)
COLUMN = click.option(
    "--column",
    "renamed",
    multiple=True,
    callback=_pairs,
    metavar="CHANNEL=COLUMN",
    help="Column that holds a channel under another name, such as p=ROLL_RATE; may be repeated.",
)
TIME = click.option("--time", default="t", show_default=True, help="Column of instants.")
