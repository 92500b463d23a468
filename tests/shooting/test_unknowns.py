"""Derivatives of a model's matrices and gain against differences."""

from dataclasses import fields, replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH

from casid.free import free_parameters
from casid.shooting.unknowns import FilterFunction, GainUnknowns

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
