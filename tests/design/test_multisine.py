"""Powers of multisines against brute force and the equivalence theorem."""

import numpy as np
import pytest

from casid.design.criterion import Goal
from casid.design.multisine import best_powers, schroeder, shared_out, unit_information
from casid.design.signals import harmonics
from casid.evaluation import MatrixFunction
from casid.free import free_parameters
from models.short_period import ShortPeriod


@pytest.mark.second
def test_two_lines_share_their_power_as_brute_force_has_it():
    rng = np.random.default_rng(1)
    units = np.array([x.T @ x for x in rng.standard_normal((3, 2, 2))])
    goal = Goal("A", np.arange(2), np.ones(2), np.zeros((2, 2)))
    p, excess = best_powers(goal, units, np.zeros(3, int), np.array([2.0]))
    grid = np.linspace(0, 2, 101)
    every = [
        goal(np.tensordot([a, b, 2 - a - b], units, 1))[0]
        for a in grid
        for b in grid[grid <= 2 - a]
    ]
    value = goal(np.tensordot(p, units, 1))[0]
    assert p.sum() == pytest.approx(2.0)
    assert value <= min(every) + 1e-3
    assert value - excess <= min(every)


def test_information_of_a_line_is_that_of_differences_of_the_response_in_the_loop():
    model = ShortPeriod()
    free = free_parameters(model)
    omega, R = np.array([0.7, 3.0]), np.diag([0.5, 2.0])
    K = np.array([[0.1, 0.3]])
    found = unit_information(MatrixFunction(free)(free.guess), K, R, omega, np.zeros(2, int))

    def response(values):
        return model.with_vector(values).system().response(omega)

    lam = model.vector()
    moves = [1e-6 * np.eye(len(lam))[k] for k in range(len(lam))]
    slopes = np.stack([(response(lam + d) - response(lam - d)) / 2e-6 for d in moves], axis=-1)
    for k, G in enumerate(response(lam)):
        J = slopes[k, :, 0] / (1 + K @ G)[0, 0]
        expected = (J.conj().T @ np.linalg.inv(R) @ J).real
        np.testing.assert_allclose(found[k], expected, rtol=1e-5, atol=1e-6 * expected.max())


def test_schroeder_phases_lower_the_peak():
    t = np.linspace(0, 20, 2000)
    omega, axis = harmonics((1.0, 12.0), 20.0), shared_out(36, 2)
    p = np.ones(len(omega))
    phase = schroeder(p, axis[: len(omega)])
    mine = axis[: len(omega)] == 0
    low = np.cos(np.outer(t, omega[mine]) + phase[mine]).sum(axis=1)
    plain = np.cos(np.outer(t, omega[mine])).sum(axis=1)
    assert np.abs(low).max() < 0.6 * np.abs(plain).max()
