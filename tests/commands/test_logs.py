from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from truths.logs import dataflash, ulog

from casid.cli import main
from casid.commands.logs import _shares


def run(*arguments):
    return CliRunner().invoke(main, ["import", *map(str, arguments)])


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    path = tmp_path_factory.mktemp("import") / "flight.ulg"
    path.write_bytes(ulog(20.0))
    return path, run(path)


@pytest.mark.slow
def test_the_command_lists_topics_channels_delays_and_stretches(imported):
    path, result = imported
    assert result.exit_code == 0, result.output
    assert "sensor_combined        4000 200" in result.output
    assert (
        "vehicle_attitude.rollspeed comes 20.0 ms after sensor_combined.gyro_rad[0]"
        in result.output
    )
    assert "Stretches in which the inputs move" in result.output
    assert f"casid identify {path.with_suffix('') / 'study.toml'}" in result.output


@pytest.mark.second
def test_the_study_it_writes_is_in_order(imported):
    path, _ = imported
    study = str(path.with_suffix("") / "study.toml")
    result = CliRunner().invoke(main, ["check", study])
    assert result.exit_code == 0, result.output


def test_listing_writes_nothing_and_names_columns(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(dataflash(2.0))
    result = run(path, "--list")
    assert result.exit_code == 0
    assert "ROut, POut, YOut" in result.output
    assert list(tmp_path.iterdir()) == [path]


def test_what_it_cannot_read_is_bad_input(tmp_path):
    path = tmp_path / "x.ulg"
    path.write_text("no log")
    result = run(path)
    assert result.exit_code == 2
    assert "it is no log of PX4" in result.output
    path.write_bytes(ulog(8.0))
    assert run(path, "--column", "p=nothing.here").exit_code == 2


def test_inputs_that_rest_have_no_share_and_keep_their_place():
    within = np.array([[True, False], [True, False], [False, False]])
    lower = np.array([[0.9, 0.1], [0.7, 0.1], [0.0, 0.1]])
    found = SimpleNamespace(inputs=("roll", "thrust"), lower=lower, within=within)
    assert _shares(found, ("yaw", "roll", "thrust")) == "-, 80%, -"
