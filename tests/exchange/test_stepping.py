"""Steps of a nonlinear structure from sample to sample, against output error's integration."""

from dataclasses import replace

import numpy as np
import pytest
from truths.climbing import AIRCRAFT, DT, X0, N, by_casid, commands
from truths.thrust import Rooted, flown

from casid import StateSpace
from casid.exchange.code import _steps
from casid.exchange.stepping import steps_of, usual_steps


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("tau", [0.0, 0.013, 0.08, 0.113, 0.29])
def test_steps_are_those_of_output_error(hold, tau):
    model, u = replace(AIRCRAFT, tau=tau), commands()
    start, step = steps_of(model, DT, hold, 2)
    z, y = start(X0, u[0]), np.empty((N, 3))
    for k in range(N):
        z, found = step(z, u[k])
        y[k] = found.full().ravel()
    known = by_casid(model, u, hold, 2)
    np.testing.assert_allclose(y, known, atol=1e-11 * np.abs(known).max())


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_steps_of_a_root_of_an_input_are_those_of_the_equations(hold):
    lam = np.array([9.0, 0.3, 5.0, 0.1125, 0.131])
    record = flown(Rooted, lam, hold)
    start, step = steps_of(Rooted().with_vector(lam), 0.05, hold, 32)
    z, y = start(record.y[0], record.u[0]), np.empty_like(record.y)
    for k in range(record.N):
        z, found = step(z, record.u[k])
        y[k] = found.full().ravel()
    near = 1e-8 if hold == "zoh" else 1e-4  # a ramp's root begins with infinite slope
    np.testing.assert_allclose(y, record.y, atol=near * np.abs(record.y).max())


def test_arguments_and_results_are_called_as_those_of_a_linear_model():
    lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    for own, linear in zip(steps_of(AIRCRAFT, DT, "foh", 1), _steps(lag, DT, "foh"), strict=True):
        assert own.name_in() == linear.name_in()
        assert own.name_out() == linear.name_out()


def test_usual_steps_follow_the_fastest_mode():
    count = usual_steps(AIRCRAFT, 1.0)
    fastest = np.abs(AIRCRAFT.system().poles()).max()
    assert count / 4 - 0.25 <= fastest <= count / 4
    assert usual_steps(AIRCRAFT, 1e-6) == 1
