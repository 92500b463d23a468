"""What every command does alike."""

import io
import logging
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from casid import ConvergenceError, ModelError, inspect_records
from casid.channels import CONTROLS
from casid.cli import main
from casid.commands.terminal import exits, logged, new_table, terminal
from casid.errors import warn
from casid.exchange.formats import read_record

FLIGHT = Path(__file__).parents[2] / "examples/ah1s/data/3211_lat.csv"


def casid(*arguments):
    return CliRunner().invoke(main, [str(each) for each in arguments])


def test_nothing_is_cut_where_the_output_is_no_terminal():
    found = inspect_records([read_record(FLIGHT, inputs=CONTROLS, outputs=("p", "phi"))])
    said = casid("inspect", FLIGHT, "--outputs", "p,phi").output
    for each in found.records[0].channels:
        numbers = f"{each.lowest:.4g} {each.highest:.4g} {each.deviation:.2g} {each.noise:.2g}"
        row = next(line.split() for line in said.splitlines() if line.startswith(f"{each.name} "))
        assert row[3:7] == numbers.split()
    for heading in ("channel", "95 % [rad/s]", "Correlation", "scale [%]", "late [ms]"):
        assert heading in said
    assert "…" not in said


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.parametrize(("outputs", "code"), [("p,phi", 0), ("p,psi", 2)])
def test_a_reader_that_leaves_changes_no_exit_code(outputs, code):
    command = [sys.executable, "-m", "casid", "inspect", str(FLIGHT), "--outputs", outputs]
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **piped) as running:
        running.stdout.close()
        said = running.stderr.read()
        assert running.wait() == code
    assert "Traceback" not in said
    assert "Broken" not in said


def test_a_narrow_terminal_folds_what_does_not_fit():
    table = new_table("title", "channel", "lowest [rad/s]", "highest")
    table.add_row("a_channel_of_a_long_name", "-0.00873612", "-1.2345e-123")
    for width in (40, 20):  # where names, then numbers do not fit
        shown = io.StringIO()
        Console(file=shown, width=width).print(table)
        assert "…" not in shown.getvalue()
        assert all(len(line) <= width for line in shown.getvalue().splitlines())


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (ValueError("no input 'lat'"), 2, "Bad input: no input 'lat'"),
        (ModelError("Lag.A is wrong"), 2, "Bad input: Lag.A is wrong"),
        (ConvergenceError("limit reached", None), 3, "No convergence: limit reached"),
        (OSError(28, "No space left"), 2, "No space left; earlier results are kept; make room"),
    ],
)
def test_what_a_user_can_mend_is_a_message_and_an_exit_code(error, code, told, capsys):
    with pytest.raises(SystemExit) as caught, exits():
        raise error
    assert caught.value.code == code
    said = capsys.readouterr()
    assert told in said.err
    assert said.out == ""


def test_what_nobody_can_mend_is_no_message():
    with pytest.raises(ZeroDivisionError), exits():
        raise ZeroDivisionError


def test_the_log_shows_only_when_wanted_and_is_left_as_it_was(capsys):
    logger = logging.getLogger("casid")
    before = logger.level, list(logger.handlers)
    for verbose in (False, True):
        with logged(terminal(), verbose):
            logger.info("a stage runs, verbose: %s", verbose)
        assert (logger.level, logger.handlers) == before
    said = capsys.readouterr().out
    assert "verbose: True" in said
    assert "verbose: False" not in said


def test_a_warning_of_data_is_told_without_the_line_it_was_issued_for(capsys):
    others = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: others.append(str(message))
        with exits():
            warn("3 outliers count as missing")
            warnings.warn("of something else", UserWarning, stacklevel=1)
    assert capsys.readouterr().err == "! 3 outliers count as missing\n"
    assert others == ["of something else"]


def test_what_is_noted_of_an_error_is_told_below_it(capsys):
    error = ValueError("no such channel")
    error.add_note("report.html is of an earlier run")
    with pytest.raises(SystemExit) as ended, exits():
        raise error
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said == "Bad input: no such channel\nreport.html is of an earlier run\n"
