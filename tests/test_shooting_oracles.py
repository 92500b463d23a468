"""Estimates against an estimator of other make: SciPy's least squares by single shooting."""

import numpy as np
import scipy.optimize
import scipy.signal
from scipy.interpolate import make_interp_spline
from truths.closed_roll import TRUTH, flown, off

from casid.shooting.output_error import output_error

SIGMA = {"ay": 0.05, "p": 0.005, "phi": 0.005}
PAD = 20  # samples at rest before the record; a spline forgets by a factor 0.27 a sample


def delayed(record, tau):
    """The first stick tau seconds late, read off a natural cubic spline."""
    before = record.t[0] - record.dt * np.arange(PAD, 0, -1)
    u = np.concatenate([np.repeat(record.u[0, 0], PAD), record.u[:, 0]])
    spline = make_interp_spline(np.concatenate([before, record.t]), u, k=3, bc_type="natural")
    return np.column_stack([spline(record.t - tau), record.u[:, 1]])


def simulated(vector, record):
    """Outputs (N, ny) of parameters, initial state and biases, over the whole record at once."""
    model = TRUTH.with_vector(vector[:7])
    system, x0, bias = model.system(), vector[7:10], vector[10:]
    plant = (system.A, system.B, system.C, system.D)
    y = scipy.signal.lsim(plant, delayed(record, model.tau), record.t, x0)[1]
    return y + bias


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


def test_estimates_and_standard_errors_are_those_of_single_shooting_least_squares():
    record = flown(seed=1).between(0, 8).with_noise(SIGMA, np.random.default_rng(4))
    fit = output_error(off(share=0.1), [record])
    start = np.concatenate([TRUTH.vector(), [0.3, -0.02, 0.01], [0.1, 0.01, -0.02]])
    values, std = least_squares(record, start)
    np.testing.assert_allclose(fit.model.vector(), values[:7], rtol=1e-4)
    np.testing.assert_allclose(fit.initial_states[0], values[7:10], rtol=1e-4)
    np.testing.assert_allclose(fit.biases[0], values[10:], rtol=1e-4)
    np.testing.assert_allclose([row.std_error for row in fit.parameters], std[:7], rtol=1e-4)
