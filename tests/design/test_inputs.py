"""Designs end to end on a small structure."""

from dataclasses import replace

import numpy as np
import pytest

from casid import DesignSettings, Limits, NonlinearModel, design_inputs, output_error, parameter
from casid.design.inputs import _problem
from models.short_period import ShortPeriod

MODEL = ShortPeriod()
STICK = MODEL.inputs[0]
NOISE = dict.fromkeys(MODEL.outputs, 0.01)
QUICK = {"dt": 0.05, "iterations": 20, "rest": 1.0}


def designed(limits=None, duration=10.0, **options):
    limits = limits or Limits(sticks={STICK: 0.1})
    settings = DesignSettings(**{**QUICK, **options})
    return design_inputs(MODEL, limits, duration, noise=NOISE, settings=settings)


@pytest.fixture(scope="module")
def design():
    limits = Limits(sticks={STICK: 0.1}, rates={STICK: 1.0}, responses={MODEL.outputs[-1]: 0.05})
    return designed(limits)


def test_a_design_beats_what_is_usually_flown_within_the_same_limits(design):
    ratio = design.std_errors / design.alternatives[0].std_errors
    assert np.exp(np.log(ratio).mean()) < 0.8
    assert max(design.used.values()) <= 1 + 1e-6
    rates = np.abs(np.diff(design.r[:, 0])) / np.diff(design.t)
    assert rates.max() <= 1.0 + 1e-6
    assert np.abs(design.y[:, -1]).max() <= 0.05 + 1e-9


def test_limits_hold_in_the_simulation_of_the_model(design):
    y = MODEL.system().simulate(design.t, design.u)
    np.testing.assert_allclose(y, design.y, atol=0.01 * np.abs(design.y).max())


def test_parameters_that_matter_are_told_better_than_when_all_count():
    name = MODEL.parameter_names()[0]
    k = designed().names.index(name)
    assert designed(matter=(name,)).std_errors[k] <= 1.02 * designed().std_errors[k]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"band": (0.5, 90.0)}, "above the Nyquist frequency 62.83"),
        ({"duration": 1.5}, "fly longer"),
        ({"matter": ("Xx",)}, "matter names 'Xx'"),
        ({"limits": Limits(sticks={"nose": 0.1})}, "limits name 'nose'"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_a_remedy(change, words):
    with pytest.raises(ValueError, match=words):
        designed(**change)


def test_noise_has_to_be_said():
    with pytest.raises(ValueError, match="how noisy the outputs are"):
        design_inputs(MODEL, Limits(sticks={STICK: 0.1}), 10.0)


class Pendulum(NonlinearModel):
    states, inputs, outputs = ("q", "theta"), ("m",), ("q", "theta")
    k: float = parameter(default=1.0, lower=0.1, upper=9.0, unit="1/s^2")

    def derivatives(self, x, u):
        return {"q": u.m - self.k * x.theta**3, "theta": x.q}


def test_nonlinear_structures_are_designed_for_at_a_trim():
    with pytest.raises(ValueError, match=r"Pendulum is nonlinear: design at a trim"):
        design_inputs(Pendulum(), Limits(sticks={"m": 0.1}), 10.0, noise={"q": 1.0, "theta": 1.0})


@pytest.mark.slow
def test_what_a_fit_knows_counts_and_its_residuals_are_the_noise(design):
    record = design.record().with_noise(NOISE, np.random.default_rng(0))
    fit = output_error(MODEL, record)
    quick = DesignSettings(**QUICK, method="steps")
    again = design_inputs(fit, Limits(sticks={STICK: 0.1}), 10.0, settings=quick)
    before = [fit[name].std_error for name in again.names]
    known = np.isfinite(before)
    np.testing.assert_allclose(again.before[known], np.array(before)[known], rtol=1e-3)
    assert np.all(again.std_errors[known] < again.before[known])
    alone = design_inputs(MODEL, Limits(sticks={STICK: 0.1}), 10.0, noise=NOISE, settings=quick)
    assert np.median(again.std_errors / alone.std_errors) < 1.05
    rows = [replace(row, cramer_rao=row.cramer_rao / 3) for row in fit.parameters]
    coloured = replace(fit, parameters=tuple(rows))  # errors three times what white noise makes
    worse = design_inputs(coloured, Limits(sticks={STICK: 0.1}), 10.0, settings=quick)
    assert np.median(worse.std_errors / again.std_errors) > 1.2


def test_information_does_not_depend_on_the_grid_it_is_computed_on():
    problem = _problem(MODEL, Limits(sticks={STICK: 0.1}), 10.0, NOISE, DesignSettings(**QUICK))
    errors = []
    for h in (0.05, 0.1):
        task = problem.task(h)
        t = h * np.arange(task.loops[0].N)
        r = 0.1 * np.sin(2.0 * t + 0.1 * t**2)[:, None] * np.clip(t, 0, 1)[:, None]
        errors.append(np.diag(task.information(r)[0]))
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.1)
