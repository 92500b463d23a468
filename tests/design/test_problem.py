"""What a design is made for: grids, and what a flight can tell."""

import numpy as np
import pytest

from casid import DesignSettings, Limits
from casid.design.problem import _ask_units, problem_of
from casid.errors import DataWarning
from models.short_period import ShortPeriod

MODEL = ShortPeriod()
STICK = MODEL.inputs[0]
NOISE = dict.fromkeys(MODEL.outputs, 0.01)


def problem(duration=10.0, **options):
    settings = DesignSettings(**{"dt": 0.05, "rest": 1.0, **options})
    return problem_of(MODEL, Limits(sticks={STICK: 0.1}), duration, None, NOISE, settings)


def test_information_does_not_depend_on_the_grid_it_is_computed_on():
    errors = []
    for h in (0.05, 0.1):
        task = problem().task(h)
        t = h * np.arange(task.loops[0].N)
        r = 0.1 * np.sin(t + 0.05 * t**2)[:, None] * np.clip(t, 0, 1)[:, None]
        errors.append(np.diag(task.information(r)[0]))
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.1)


@pytest.mark.parametrize(("dt", "duration"), [(0.02, 61.3), (0.015, 31.0), (0.05, 10.0)])
def test_the_coarse_grid_ends_with_the_card(dt, duration):
    made = problem(duration, dt=dt)
    fine, rough = made.task(dt).loops[0], made.task(made.coarse()).loops[0]
    assert rough.h * (rough.N - 1) == pytest.approx(fine.h * (fine.N - 1), rel=1e-12)
    assert rough.h >= dt - 1e-12


def test_models_drawn_are_off_by_the_spread_that_was_asked():
    poles = []
    for spread in (0.001, 0.002):
        loops = list(problem(spread=spread, draws=10)._held(10, 0, 0.1))
        poles.append([loop.growth for loop in loops])
    off = np.array(poles) - MODEL.system().poles().real.max()
    assert off.shape == (2, 10)
    assert (np.abs(off[0]) > 0).any()
    np.testing.assert_allclose(off[1], 2 * off[0], rtol=0.02, atol=1e-5)


def test_parameters_of_which_only_combinations_are_told_are_found():
    made = problem()
    n = len(made.frees[0].index)
    F = np.diag(np.arange(1.0, n + 1))
    F[:2, :2] = 1.0
    assert made.tellable(F).tolist() == [False, False] + [True] * (n - 2)
    with pytest.raises(ValueError, match="no input identifies"):
        made.tellable(np.ones((n, n)))


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (Limits(sticks={"lat": 10.0}), "'lat' is 10, in fractions of full travel: .* in percent?"),
        (Limits(sticks={"lat": 0.1}, responses={"phi": 30.0}), "'phi' is 30, in rad: .* degrees?"),
    ],
)
def test_limits_that_look_like_percent_or_degrees_are_asked_about(limits, words):
    with pytest.warns(DataWarning, match=words):
        _ask_units(limits)


def test_a_manoeuvre_too_short_for_its_samples_names_their_interval():
    with pytest.raises(ValueError, match=r"or sample faster: .* here dt = 0.5 s"):
        problem(dt=0.5, band=(0.1, 1.0))
