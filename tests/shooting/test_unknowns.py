"""Derivatives of a model's matrices and gain against differences."""

from dataclasses import fields, replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH

from casid.free import free_parameters
from casid.shooting.unknowns import FilterFunction, GainUnknowns, NoiseUnknowns

GAIN = np.arange(9.0).reshape(3, 3) / 10


@pytest.mark.parametrize("gain_free", [False, True])
def test_slopes_are_those_of_the_models_own_matrices(gain_free):
    free = free_parameters(TRUTH, fixed=("Lped",))
    function = FilterFunction(free, GainUnknowns(GAIN, gain_free))
    n = len(free.index)
    at = np.concatenate([free.guess, GAIN.ravel()])[: function.nf]
    found = function(at)
    assert function.nf == n + 9 * gain_free
    system = TRUTH.system()
    for name in "ABCD":
        np.testing.assert_allclose(getattr(found, name), getattr(system, name), rtol=1e-15)
    np.testing.assert_array_equal(found.K, GAIN)
    np.testing.assert_allclose(found.tau, [TRUTH.tau, 0.0])
    for a, name in enumerate((*free.names, *range(9 * gain_free))):
        h = 1e-6
        if isinstance(name, int):  # an entry of the gain, by rows
            expected = dict.fromkeys("ABCD", 0.0) | {"K": np.eye(9)[name].reshape(3, 3)}
        else:
            up, down = (replace(TRUTH, **{name: getattr(TRUTH, name) + s * h}) for s in (1, -1))
            up, down = up.system(), down.system()
            expected = {m: (getattr(up, m) - getattr(down, m)) / (2 * h) for m in "ABCD"}
            expected |= {"K": 0.0, "tau": [float(name == "tau"), 0.0]}
        for m, slope in expected.items():  # linear in each: exact to rounding over the step
            np.testing.assert_allclose(
                getattr(found, f"{m}_lam")[..., a] - slope, 0, atol=1e-8, err_msg=f"{m} by {name}"
            )
    assert all(np.isfinite(getattr(found, each.name)).all() for each in fields(found))


@pytest.mark.parametrize("full", [False, True])
def test_a_covariance_is_that_of_its_factors_and_its_slopes_those_of_differences(full):
    r0, least = np.array([4.0, 1.0, 0.25]), np.array([0.1, 0.2, 0.3])
    noises = NoiseUnknowns(q0=np.array([1.0, 2.0]), r0=r0, least=least, given=None, full=full,
                           start=np.zeros(8 if full else 5))  # fmt: skip
    nx, nr, nt = noises.count
    assert (nx, nr, nt) == (2, 3, 3 * full)
    eta = np.random.default_rng(0).uniform(0.1, 0.6, nx + nr + nt)
    R, slope = noises.covariance(eta)
    T = np.eye(3)
    if full:
        T[1, 0], T[2, 0], T[2, 1] = eta[5:] * [0.5, 0.25, 0.5]  # units of the outputs
    np.testing.assert_allclose(R, T @ np.diag(least + r0 * (np.exp(eta[2:5]) - 1)) @ T.T)
    for k, step in enumerate(1e-6 * np.eye(len(eta))):
        numeric = (noises.covariance(eta + step)[0] - noises.covariance(eta - step)[0]) / 2e-6
        np.testing.assert_allclose(slope[..., k], numeric, atol=1e-8)


def test_noises_are_never_negative_a_hair_beyond_their_bound():
    noises = NoiseUnknowns(q0=np.array([1.0, 2.0]), r0=np.array([4.0]), least=np.zeros(1),
                           given=None, full=False, start=np.zeros(3))  # fmt: skip
    beyond = np.full(3, -1e-8)  # where an interior point may go
    np.testing.assert_array_equal(noises.densities(beyond)[0], [0.0, 0.0])
    np.testing.assert_array_equal(noises.covariance(beyond)[0], [[0.0]])
