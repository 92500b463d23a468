"""Starts of the output-error programme."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
from scipy.linalg import expm
from truths.closed_roll import TRUTH, flown

from casid.free import free_parameters
from casid.shooting.innovation import starting_noises
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator
from casid.shooting.starting import (
    accumulated,
    channel_size,
    continued_programme,
    starting_programme,
)


def test_accumulated_covariance_is_its_integral_for_stiff_and_unstable_dynamics():
    A, Q = np.array([[-30.0, 5.0], [0.0, 0.4]]), np.array([[1.0, 0.2], [0.2, 2.0]])

    def rate(s, i, j):
        return (expm(A * s) @ Q @ expm(A.T * s))[i, j]

    found = accumulated(A, Q, 3.0)
    for i, j in np.ndindex(2, 2):
        expected = scipy.integrate.quad(rate, 0, 3, args=(i, j), limit=500)[0]
        np.testing.assert_allclose(found[i, j], expected, rtol=1e-9)
    # The exponential of the whole span would lose all digits: e^{30·20} beside e^{-30·20}.
    assert np.linalg.eigvalsh(accumulated(np.diag([-30.0, -1.0]), Q, 20.0)).min() > 0


def test_the_size_of_a_channel_is_that_of_its_measured_samples_about_the_level():
    y = np.array([[3.0, 5.0, 1.0], [5.0, 0.0, 1.0], [1.0, 9.0, 1.0]])
    patterns = np.array([[True, True, True], [True, False, True]])
    layout = SimpleNamespace(y=y, patterns=patterns, pattern=np.array([0, 1, 0]))
    found = channel_size(SimpleNamespace(layout=layout, level=lambda: (0.0, np.array([1, 2, 1]))))
    np.testing.assert_allclose(found, [np.sqrt((4 + 16 + 0) / 3), np.sqrt((9 + 49) / 2), 1.0])


@pytest.mark.parametrize("filtering", [False, True])
def test_a_start_follows_the_data_from_the_guess_and_its_noise_is_what_it_leaves(filtering):
    records, free = [flown(seed=k).between(0, 3) for k in (1, 2)], free_parameters(TRUTH)
    noises = starting_noises(TRUTH, records, "diagonal") if filtering else None
    evaluator = Evaluator(free, lay_out(records, 1.0), noises)
    programme, point = starting_programme(evaluator, free, "diagonal", True)
    nf = len(free.index)
    np.testing.assert_array_equal(point.lam[:nf], free.guess)
    motion = evaluator.simulate(point)
    left = np.mean(motion.residuals**2, axis=0)
    assert (left < 0.5 * channel_size(evaluator) ** 2).all()  # at rest all would be left
    wanted = np.ones(evaluator.ny) if filtering else left  # a filter has its own, scaled later
    np.testing.assert_allclose(np.diag(programme.noise.given), wanted, rtol=1e-6)
    x = programme.pack(point)
    again, other = continued_programme(evaluator, free, "diagonal", programme, x)
    np.testing.assert_allclose(other.lam[:nf], free.guess, rtol=1e-12)
    at = np.sort(evaluator.layout.start)
    np.testing.assert_allclose(other.nodes, programme.values(x).motion.states[at])
    np.testing.assert_allclose(np.diag(again.noise.given), wanted, rtol=0.5)
