"""Inputs at the stages of Runge-Kutta steps."""

import numpy as np
import pytest
from truths.brute_force import simulate_finely

from casid.intersample import delayed_input
from casid.shooting.stages import stage_inputs

A, B = np.array([[-1.0, -4.0], [1.0, 0.0]]), np.array([[3.0], [0.0]])
H = 0.05


def by_runge_kutta(u, delay, hold, substeps):
    """States (N, 2) of the plant with the stages' inputs."""
    t = H * np.arange(len(u))
    held = delayed_input(t, u, np.array([delay * H]), hold)
    stages = stage_inputs([held], [hold], np.full(len(u), H), substeps)[0]
    eta, x, kept = H / substeps, np.zeros(2), [np.zeros(2)]
    for k in range(len(u) - 1):
        for first, middle, last in stages[k]:
            k1 = A @ x + B @ first
            k2 = A @ (x + eta / 2 * k1) + B @ middle
            k3 = A @ (x + eta / 2 * k2) + B @ middle
            k4 = A @ (x + eta * k3) + B @ last
            x = x + eta / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        kept.append(x)
    return np.array(kept)


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.75, 2.45])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_breaks_within_a_step_cost_no_accuracy(hold, delay):
    u = np.random.default_rng(1).standard_normal((60, 1))
    exact = simulate_finely((A, B, np.eye(2), np.zeros((2, 1))), H, u, [delay], hold)
    size = np.abs(exact).max()
    errors = [np.abs(by_runge_kutta(u, delay, hold, n) - exact).max() for n in (1, 2, 4)]
    assert errors[0] < 2e-5 * size
    assert errors[1] < errors[0] / 7  # third order at least, where an input jumps in a step
    assert errors[2] < errors[1] / 7


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_derivatives_by_the_delay_are_those_of_differences(hold):
    u, step = np.random.default_rng(2).standard_normal((30, 1)), 1e-6
    t = H * np.arange(30)

    def at(tau):
        held = delayed_input(t, u, np.array([tau]), hold)
        return stage_inputs([held], [hold], np.full(30, H), 2)

    tau = 1.3 * H
    difference = (at(tau + step)[0] - at(tau - step)[0]) / (2 * step)
    np.testing.assert_allclose(at(tau)[1], difference, atol=1e-6 * np.abs(difference).max())
