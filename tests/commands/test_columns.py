"""Options about columns, as typed."""

import click
import pytest
from click.testing import CliRunner

from casid.commands.columns import COLUMN, TIME, UNIT, refuse_beside_study


@click.command()
@UNIT
@COLUMN
@TIME
def told(units, renamed, time):
    click.echo(f"{units} {renamed} {time}")


def test_pairs_become_mappings_and_may_be_repeated():
    typed = ["--unit", "p=deg/s", "--unit", "lat=%", "--column", "p=ROLL=RATE"]
    said = CliRunner().invoke(told, typed).output.strip()
    assert said == "{'p': 'deg/s', 'lat': '%'} {'p': 'ROLL=RATE'} t"


@pytest.mark.parametrize("typed", ["p", "p=", "pdeg/s"])
def test_half_a_pair_is_refused_with_what_was_expected(typed):
    found = CliRunner().invoke(told, ["--unit", typed])
    assert found.exit_code == 2
    assert f"'{typed}': expected CHANNEL=UNIT" in found.output


def test_options_beside_a_study_are_refused_by_name_and_none_is_not():
    refuse_beside_study(unit={}, record=())
    with pytest.raises(ValueError, match="--unit, --record cannot be given with a study"):
        refuse_beside_study(unit={"p": "deg/s"}, fixed=(), record=("a.csv",))
