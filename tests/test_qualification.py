"""Tolerance bands: their width by hand, pass and fail, words that are no tolerance."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from casid import Record, StateSpace, qualify, validate
from casid.qualification import SOURCE, TOLERANCES, read_tolerance

DEG = np.pi / 180
T = 0.02 * np.arange(500)


def flown(gain=1.0, y=None):
    """Roll rate after a step of the stick, and what a model of another gain makes of it."""
    u = np.where(T > 2, 0.1, 0.0)[:, None]
    truth = StateSpace([[-2.0]], [[4.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
    model = StateSpace([[-2.0]], [[4.0 * gain]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
    record = Record(T, u, truth.simulate(T, u) if y is None else y, ("lat",), ("p",), "step")
    return validate({"m": model}, record)


def test_the_band_is_the_larger_of_share_and_number():
    found = qualify(flown(), tolerances={"p": "10 % or 0.5 deg/s"})
    half, change = found.width[0][:, 0], 0.2 * (1 - np.exp(-2 * np.clip(T - 2.01, 0, None)))
    # The step is a ramp of one sample, hence the room.
    np.testing.assert_allclose(half, np.maximum(0.1 * change, 0.5 * DEG), atol=5e-5)
    assert half[0] == pytest.approx(0.5 * DEG)
    assert half[-1] == pytest.approx(0.02, rel=1e-3)


def test_a_model_passes_until_its_error_leaves_the_band():
    # A validation fits bias and initial state, so the error is what a gain leaves of the step.
    right, wrong = qualify(flown()), qualify(flown(gain=2.5), tolerances={"p": "2 deg/s"})
    assert right.passed.all()
    assert right.largest[0, 0] < 1e-6
    assert not wrong.passed.any()
    error = np.abs(wrong.validation.simulated["m"][0] - wrong.validation.measured[0].y)[:, 0]
    assert wrong.largest[0, 0] == pytest.approx(error.max() / (2 * DEG))
    assert wrong.outside[0, 0] == pytest.approx(np.mean(error > 2 * DEG))
    assert "0 of 1 passed; failed: p of step" in repr(wrong)


def test_what_was_not_measured_neither_passes_nor_fails():
    y = flown().measured[0].y.copy()
    y[50:90] = np.nan
    assert qualify(flown(y=y)).passed.all()


def test_a_model_that_grows_beyond_all_numbers_fails():
    seen = flown()
    seen.simulated["m"][0][300:] = [[np.nan]]
    found = qualify(seen)
    assert not found.passed.any()
    assert found.outside[0, 0] == pytest.approx(200 / 500)


def test_outputs_without_a_tolerance_are_named():
    assert qualify(flown()).unjudged == ()
    both = Record(T, np.ones((500, 1)), np.ones((500, 2)), ("lat",), ("p", "ay"))
    model = StateSpace([[-2.0]], [[4.0]], [[1.0], [2.0]], [[0.0]] * 2, None, ("lat",), ("p", "ay"))
    assert qualify(validate({"m": model}, both)).unjudged == ("ay",)


def test_the_documentation_has_the_usual_tolerances_to_edit():
    page = (Path(__file__).parents[1] / "docs/reference/study.md").read_text("utf-8")
    (text,) = (each.split("```")[0] for each in page.split("```toml") if "[qualification." in each)
    assert tomllib.loads(text)["qualification"] == {"source": SOURCE, "tolerances": TOLERANCES}


def test_the_usual_tolerances_are_understood():
    bands = {name: read_tolerance(name, text) for name, text in TOLERANCES.items()}
    assert (bands["p"].share, bands["p"].least) == (0.1, pytest.approx(3 * DEG))
    assert bands["theta"].least == pytest.approx(1.5 * DEG)
    assert bands["az"].least == pytest.approx(0.980665)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "deg/s",
        "10 percent",
        "or",
        "3 furlong",
        "10 %",
        "0 %",
        "10 % or 0 deg/s",
        "-1 deg",
        "3 deg",
        "3 m/s",
        "0.2 g",
        5,
    ],
)
def test_words_that_are_no_tolerance_are_refused(text):
    with pytest.raises(ValueError, match="'p'"):
        read_tolerance("p", text)


def test_an_unknown_model_and_outputs_without_tolerance_are_refused():
    with pytest.raises(ValueError, match="no model 'x'; the validation has m"):
        qualify(flown(), "x")
    with pytest.raises(ValueError, match="none of the outputs p has a tolerance"):
        qualify(flown(), tolerances={"q": "2 deg/s"})
