"""Estimates against an estimator of other make: SciPy's least squares by single shooting."""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from truths.closed_roll import TRUTH, flown, off

from casid.shooting.output_error import OutputError, output_error

SIGMA = {"ay": 0.05, "p": 0.005, "phi": 0.005}
H = 0.02  # s


def steps_of(plant, share):
    """(e^{As}, what the input at the step's begin does, what its rate does), s a share of H."""
    A, B, nx, nu = plant.A, plant.B, 3, 2
    M = np.zeros((nx + 2 * nu, nx + 2 * nu))
    M[:nx, :nx], M[:nx, nx : nx + nu], M[nx : nx + nu, nx + nu :] = A, B, np.eye(nu)
    E = scipy.linalg.expm(M * share * H)[:nx]
    return E[:, :nx], E[:, nx : nx + nu], E[:, nx + nu :]


def simulated(vector, record):
    """Outputs (N, ny) of parameters, initial state and biases, over the whole record at once.

    The first stick is heard late: within every step one sample of it passes, so that each step is
    two of straight lines.
    """
    model = TRUTH.with_vector(vector[:7])
    plant, x, t, u = model.system(), vector[7:10], record.t, record.u
    stick = np.interp(t - model.tau, t, u[:, 0])
    share = (model.tau / H) % 1.0  # of the step, where the sample passes
    u = np.column_stack([stick, u[:, 1]])
    between = np.column_stack(
        [
            np.interp(t + share * H - model.tau, t, record.u[:, 0]),
            np.interp(t + share * H, t, u[:, 1]),
        ]
    )
    first, second, states = steps_of(plant, share), steps_of(plant, 1 - share), [x]
    for k in range(len(t) - 1):
        for (E, G, R), a, b, s in (
            (first, u[k], between[k], share), (second, between[k], u[k + 1], 1 - share)
        ):  # fmt: skip
            x = E @ x + G @ a + R @ (b - a) / (s * H)
        states.append(x)
    return np.array(states) @ plant.C.T + u @ plant.D.T + vector[10:]


def least_squares(record, start):
    """Estimates and standard errors (13,), R re-estimated until it settles."""
    vector, sigma = start, np.array(list(SIGMA.values()))
    for _ in range(8):
        found = scipy.optimize.least_squares(
            lambda v, sigma=sigma: ((simulated(v, record) - record.y) / sigma).ravel(),
            vector, jac="3-point", x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-14,
        )  # fmt: skip
        vector, last = found.x, sigma
        sigma = np.std(simulated(vector, record) - record.y, axis=0)
        if np.allclose(sigma, last, rtol=1e-9):
            break
    return vector, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


@pytest.mark.second
def test_estimates_and_standard_errors_are_those_of_single_shooting_least_squares():
    record = flown(seed=1).between(0, 8).with_noise(SIGMA, np.random.default_rng(4))
    fit = output_error(off(share=0.1), [record])
    start = np.concatenate([TRUTH.vector(), [0.3, -0.02, 0.01], [0.1, 0.01, -0.02]])
    values, std = least_squares(record, start)
    np.testing.assert_allclose(fit.model.vector(), values[:7], rtol=1e-4)
    np.testing.assert_allclose(fit.initial_states[0], values[7:10], rtol=1e-4)
    np.testing.assert_allclose(fit.biases[0], values[10:], rtol=1e-4)
    np.testing.assert_allclose([row.cramer_rao for row in fit.parameters], std[:7], rtol=1e-4)


def bounded(record, start, lower, upper):
    """Estimates (13,) within bounds of the parameters (7,), and the sum of squares, halved."""
    sigma = np.array(list(SIGMA.values()))
    limits = np.append(lower, np.full(6, -np.inf)), np.append(upper, np.full(6, np.inf))
    found = scipy.optimize.least_squares(
        lambda v: ((simulated(v, record) - record.y) / sigma).ravel(),
        np.clip(start, limits[0] + 1e-6, limits[1] - 1e-6), bounds=limits, jac="3-point",
        x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-10,
    )  # fmt: skip
    return found.x, found.cost


@pytest.mark.campaign
def test_a_case_beside_another_is_bounded_least_squares_and_its_prices_are_slopes_of_their_cost():
    record = flown(seed=1).between(0, 8).with_noise(SIGMA, np.random.default_rng(4))
    R = np.diag(list(SIGMA.values())) ** 2
    wide = output_error(off(share=0.1), [record], R=R)
    at = {name: i for i, name in enumerate(TRUTH.parameter_names())}
    lower = np.array([row.lower for row in wide.parameters])
    upper = np.array([row.upper for row in wide.parameters])
    lower[at["Lp"]] = wide["Lp"].value + 2 * wide["Lp"].cramer_rao
    upper[at["Lv"]] = wide["Lv"].value - wide["Lv"].cramer_rao
    bounds = {name: (lower[i], upper[i]) for name, i in at.items()}
    fit = OutputError(R=R).fit(wide.model, [record], bounds=bounds, near=wide)
    assert fit.status == "solved by quadratic models"
    start = np.concatenate([fit.model.vector(), fit.initial_states[0], fit.biases[0]])
    values, least = bounded(record, start, lower, upper)
    std = np.array([row.cramer_rao for row in wide.parameters])
    np.testing.assert_allclose(fit.model.vector() / std, values[:7] / std, rtol=0, atol=1e-3)
    assert fit.cost - wide.cost == pytest.approx(
        least - bounded(record, start, 0 * lower - 1e3, 0 * upper + 1e3)[1], rel=1e-4
    )
    assert [row.name for row in fit.parameters if row.active] == ["Lv", "Lp"]
    for name, side in (("Lp", lower), ("Lv", upper)):
        costs = []
        for sign in (-1, 1):
            moved = side.copy()
            moved[at[name]] += sign * 0.05 * std[at[name]]
            limits = (moved, upper) if side is lower else (lower, moved)
            costs.append(bounded(record, start, *limits)[1])
        slope = (costs[1] - costs[0]) / (0.1 * std[at[name]])
        assert fit[name].multiplier == pytest.approx(slope, rel=1e-3)
