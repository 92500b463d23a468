"""The command `design` on a small study."""

import click.testing
import pytest
from truths.roll_study import write_study

from casid.cli import main


def run(*arguments):
    return click.testing.CliRunner().invoke(main, ["design", *map(str, arguments)])


def test_a_study_without_a_fit_is_designed_from_its_guess(tmp_path):
    study = write_study(tmp_path)
    result = run(study, "--duration", "12", "--method", "steps", "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "steps on lat, 12 s: standard errors 0." in result.output
    card = (tmp_path / "out/design/card.csv").read_text().splitlines()
    assert card[0] == "t,lat"
    largest = max(abs(float(row.split(",")[1])) for row in card[1:])
    assert 0.03 < largest <= 0.05 + 1e-9  # the 3-2-1-1 of the study has 5 %
    assert (tmp_path / "out/design/design.png").stat().st_size > 10_000
    assert "## Standard errors" in (tmp_path / "out/design/design.md").read_text()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--stick", "lat"], "expected NAME=NUMBER"),
        (["--stick", "lat=0"], "leaves nothing to fly"),
        (["--response", "q=1"], "limits name 'q'"),
        (["--feedback", "lat:q=1"], "feedback names 'q'"),
        (["--method", "magic"], "method = 'magic'"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, options, words):
    result = run(write_study(tmp_path), "--duration", "12", *options)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())
