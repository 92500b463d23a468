"""Tolerance bands: their width by hand, pass and fail, words that are no tolerance."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from casid import Record, StateSpace, qualify, summary, validate
from casid.qualification import SOURCE, TOLERANCES, read_tolerance

DEG = np.pi / 180
T = 0.02 * np.arange(500)


def flown(gain=1.0, y=None, horizon=None):
    """Roll rate after a step of the stick, and what a model of another gain makes of it."""
    u = np.where(T > 2, 0.1, 0.0)[:, None]
    truth = StateSpace([[-2.0]], [[4.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
    model = StateSpace([[-2.0]], [[4.0 * gain]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
    record = Record(T, u, truth.simulate(T, u) if y is None else y, ("lat",), ("p",), "step")
    return validate({"m": model}, record, horizon=horizon)


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


def test_a_constant_larger_than_the_tolerance_is_told():
    y = flown().measured[0].y + 5 * DEG
    found = qualify(flown(y=y), tolerances={"p": "3 deg/s"})
    assert found.passed.all()
    assert found.offset[0, 0] == pytest.approx(5 / 3)
    assert "passed only with a constant beyond the tolerance: p of step" in found.headline()
    assert "constant" not in qualify(flown(y=y), tolerances={"p": "6 deg/s"}).headline()


def test_a_figure_beside_one_shows_on_which_side_it_is():
    seen = flown(gain=2.5)
    error = np.abs(seen.simulated["m"][0] - seen.measured[0].y).max() / DEG
    found = qualify(seen, tolerances={"p": f"{error / 1.0004:.9f} deg/s"})
    assert "failed: p of step (1.0004)" in found.headline()
    assert summary(found).splitlines()[-1].endswith("| FAIL 1.0004 |")


def test_a_record_in_which_nothing_moves_is_named():
    moved, rest = flown(), flown(0.0, np.full((500, 1), 2.9 * DEG))
    assert qualify(moved).still == ()
    found = qualify(rest)
    assert (found.passed.all(), found.still) == (True, ("step",))
    assert "no measurement leaves the tolerance band around trim: step" in found.headline()
    y = np.zeros((500, 1))
    y[300] = 3.1 * DEG  # the usual band is of 3 deg/s or, of what grows, 10 %
    assert qualify(flown(0.0, y)).still == ()
    y[0] = np.nan
    assert qualify(flown(0.0, y)).still == ()
    y[300] = np.nan
    assert qualify(flown(0.0, y)).still == ("step",)


def test_a_band_that_noise_alone_may_leave_is_named():
    rng, noise, seen = np.random.default_rng(5), 0.3 * DEG, flown()
    # By counting: how often noise of that size stays in the band over all of the record.
    for band, told in (("0.9 deg/s", True), ("1.5 deg/s", False)):
        half = qualify(seen, tolerances={"p": band}).width[0][:, 0]
        passed = np.mean(
            [(np.abs(noise * rng.standard_normal(500)) <= half).all() for _ in range(2000)]
        )
        found = qualify(seen, tolerances={"p": band}, noise={"p": noise})
        assert found.chance[0, 0] == pytest.approx(passed, abs=0.04)  # 4 deviations of 2000
        assert ("noise alone may leave the band: p of step" in found.headline()) is told
    assert np.isnan(qualify(seen).chance).all()
    with pytest.raises(ValueError, match="noise of unknown output 'P'"):
        qualify(seen, noise={"P": 0.1})


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
    assert found.headline() == "m: 0 of 1 passed; failed: p of step (inf)"


def test_samples_before_the_first_prediction_do_not_count():
    # Predictions of 0.5 s begin behind three times as much past, 75 samples of 0.02 s.
    seen = flown(gain=2.5, horizon=0.5)
    assert (seen.begins, np.isnan(seen.simulated["m"][0][:76]).all()) == ((76,), True)
    found = qualify(seen, tolerances={"p": "2 deg/s"})
    error = np.abs(seen.simulated["m"][0] - seen.measured[0].y)[76:, 0]
    assert found.largest[0, 0] == pytest.approx(error.max() / (2 * DEG))
    assert found.outside[0, 0] == pytest.approx(np.mean(error > 2 * DEG))
    assert qualify(flown(horizon=0.5)).headline() == "m: 1 of 1 passed"
    seen.simulated["m"][0][200:] = np.inf  # what runs away once predictions have begun does count
    assert qualify(seen).headline() == "m: 0 of 1 passed; failed: p of step (inf)"
    seen.simulated["m"][0][:] = np.nan
    assert qualify(seen).outside[0, 0] == 1.0


def test_an_output_that_the_model_lacks_or_that_nobody_measured_is_not_judged():
    u, ones = np.ones((500, 1)), np.ones((500, 1))
    lacks = StateSpace([[-2.0]], [[4.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
    records = [
        Record(T, u, np.hstack([ones, y]), ("lat",), ("p", "phi"), name)
        for name, y in (("whole", ones), ("part", np.nan * ones))
    ]
    has = StateSpace([[-2.0]], [[4.0]], [[1.0]] * 2, [[0.0]] * 2, None, ("lat",), ("p", "phi"))
    seen = validate({"lacks": lacks, "has": has}, records)
    rest = "; no measurement leaves the tolerance band around trim: whole, part"
    off = "; passed only with a constant beyond the tolerance: p of whole, p of part"
    told = f"lacks: 2 of 2 passed{off}{rest}; not judged: phi of whole, phi of part"
    assert qualify(seen, "lacks").headline() == told
    found = qualify(seen, "has")
    off = off.replace(", p of", ", phi of whole, p of")
    assert found.headline() == f"has: 3 of 3 passed{off}{rest}; not judged: phi of part"
    assert summary(found).splitlines()[-1].endswith("| not judged |")
    nothing = qualify(seen, "lacks", {"phi": "3 deg"}).headline()
    assert nothing == "lacks: 0 of 0 passed; not judged: phi of whole, phi of part"


def test_a_tolerance_of_an_output_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match=r"'pp'; did you mean 'p'\?"):
        qualify(flown(), tolerances={"p": "2 deg/s", "pp": "2 deg/s"})
    edited = qualify(flown(), tolerances={"p": "2 deg/s", "theta": "2 deg"})
    assert (edited.outputs, edited.idle) == (("p",), ("theta",))
    assert "no such output: theta" in repr(edited)
    assert qualify(flown()).idle == ()


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
