"""Starts of the output-error programme."""

from types import SimpleNamespace

import numpy as np
import scipy.integrate
from scipy.linalg import expm

from casid.shooting.starting import accumulated, channel_size


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
