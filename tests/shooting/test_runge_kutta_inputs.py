"""Inputs at the stages of Runge-Kutta steps."""

import numpy as np
import pytest
from truths.brute_force import simulate_finely
from truths.thrust import instants, piece

from casid.intersample import delayed_input
from casid.shooting.runge_kutta_inputs import stage_inputs

A, B = np.array([[-1.0, -4.0], [1.0, 0.0]]), np.array([[3.0], [0.0]])
H = 0.05


def by_runge_kutta(u, delay, hold, substeps):
    """States (N, 2) of the plant with the stages' inputs."""
    t = H * np.arange(len(u))
    held = delayed_input(t, u, np.array([delay * H]), hold)
    stages = stage_inputs([held], [hold], np.full(len(u), H), (1, substeps), ()).u
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
        found = stage_inputs([held], [hold], np.full(30, H), (2, 1), ())
        return found.u, found.late

    tau = 1.3 * H
    difference = (at(tau + step)[0] - at(tau - step)[0]) / (2 * step)
    np.testing.assert_allclose(at(tau)[1], difference, atol=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize("late", [1.0, 2.0])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_breaks_on_samples_move_with_their_delay_like_those_between(hold, late):
    u, step, within = np.random.default_rng(3).standard_normal((30, 1)), 1e-6, np.array([1.5 * H])

    def at(tau):
        held = delayed_input(H * np.arange(30), u, np.array([tau]), hold, within)
        found = stage_inputs([held], [hold], np.full(30, H), (2, 1), ())
        return found.u, found.late

    difference = (at(late * H + step)[0] - at(late * H - step)[0]) / (2 * step)
    found = at(late * H)[1]
    np.testing.assert_allclose(found, difference, atol=1e-6 * np.abs(difference).max())


LATE = np.array([0.3, 0.3, 2.75]) * H  # two of the inputs come together


def cut_up(hold, shares=1, tau_lam=None, irregular=True):
    """Instants, inputs of 0 and 1 that break at every sample, and their steps."""
    t = instants(40, H, irregular)
    u = np.tile([0.0, 1.0], 20)[:, None] * [1.0, 1.0, -1.0]
    held = delayed_input(t, u, LATE, hold)
    h = np.append(np.diff(t), t[-1] - t[-2])
    return t, u, h, stage_inputs([held], [hold], h, (2, shares), tau_lam=tau_lam)


@pytest.mark.parametrize("shares", [1, 3])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_inputs_of_steps_cut_at_their_breaks_are_the_inputs_themselves(hold, shares):
    t, u, h, stages = cut_up(hold, shares)
    assert len(np.unique(stages.count)) > 1  # several samples of one input may fall in an interval
    for k in range(4, 38):
        eta = stages.eta[k, : stages.count[k]]
        begin = t[k] + np.cumsum(np.append(0.0, eta[:-1]))
        assert eta.sum() == pytest.approx(h[k], rel=1e-12)
        for s, (a, length) in enumerate(zip(begin, eta, strict=True)):
            for j, late in enumerate(LATE):
                value, slope = piece(t, u[:, j], hold, a + length / 2 - late, a - late)
                true = value + slope * length * np.array([0.0, 0.5, 1.0])
                np.testing.assert_allclose(stages.u[k, s, :, j], true, atol=1e-10)
                np.testing.assert_allclose(stages.late[k, s, :, j], -slope, atol=1e-8)


def test_steps_are_cut_once_where_inputs_come_together_and_not_at_their_ends():
    _, _, _, apart = cut_up("zoh", irregular=False)
    assert (apart.count[4:38] == 4).all()  # 0.3 and 0.75 of an interval, beside its half
    _, _, _, moved = cut_up("zoh", tau_lam=np.diag([1.0, 2.0, 3.0]), irregular=False)
    assert (moved.count[4:38] == 5).all()
    assert sorted(moved.mover[10, 1:3]) == [0, 1]
    np.testing.assert_array_equal(moved.mover[10, [0, 3, 4]], [-1, -1, 2])
    t = H * np.arange(10)
    held = delayed_input(t, (t > 0.2)[:, None] * 1.0, np.array([H]), "zoh")
    whole = stage_inputs([held], ["zoh"], np.full(10, H), (2, 1))
    assert whole.eta.shape == (10, 2)


def test_a_line_that_is_bent_by_roundings_alone_is_not_cut():
    t = 0.1 * np.arange(40)
    u = np.clip(0.3 * t - 0.5, 0.0, None)[:, None]
    held = delayed_input(t, u, np.array([0.03]), "foh")
    stages = stage_inputs([held], ["foh"], np.full(40, 0.1), (1, 1))
    assert (stages.count == 2).sum() <= 2
    true = np.interp(t - 0.03, t, u[:, 0])
    np.testing.assert_allclose(stages.u[:, 0, 0, 0], true, atol=1e-9)
