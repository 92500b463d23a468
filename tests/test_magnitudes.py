"""Stable systems above given magnitudes: exact where one is, and what their numbers say."""

import control
import numpy as np
import pytest

from casid.magnitudes import mean, realisation, roots, with_two_states_more

X = np.linspace(np.log(0.1), np.log(30.0), 800)


def numbers(odd):
    """log(W(0)²) of 4, a zero at 3 and a pole at 0.5 rad/s if odd, a pair of each."""
    pair = [np.log(2.0), np.log(0.4), np.log(7.0), np.log(0.03)]
    return np.array([np.log(4.0), *([np.log(3.0), np.log(0.5)] if odd else []), *pair])


@pytest.mark.parametrize("odd", [False, True])
def test_a_realisation_has_the_zeros_and_poles_of_its_numbers(odd):
    v = numbers(odd)
    W, s = realisation(v), control.tf("s")
    known = 2 * (s**2 / 4 + 0.4 * s + 1) / (s**2 / 49 + 0.06 / 7 * s + 1)
    known = known * (s / 3 + 1) / (s / 0.5 + 1) if odd else known
    omega = np.exp(X)
    assert (W.inputs, W.outputs) == (("w",), ("z",))
    np.testing.assert_allclose(W.response(omega)[:, 0, 0], known(1j * omega), rtol=1e-9)
    complex_ones = np.concatenate([known.zeros(), known.poles()])
    complex_ones = complex_ones[complex_ones.imag > 0]
    np.testing.assert_allclose(np.sort_complex(roots(v)), np.sort_complex(complex_ones), rtol=1e-9)


@pytest.mark.parametrize("odd", [False, True])
def test_the_magnitude_of_a_system_is_covered_by_that_system(odd):
    # Nothing of its order lies above it and is less in the mean: its own magnitude to the grid's
    # hundredth of log(abs(W)²), half of that in log(abs(W)).
    y = 2 * np.log(np.abs(realisation(numbers(odd)).response(np.exp(X))[:, 0, 0]))
    v = np.array([y.max()])
    for states in (1, 3) if odd else (0, 2):
        v = with_two_states_more(v, X, y, states)
    over = np.log(np.abs(realisation(v).response(np.exp(X))[:, 0, 0])) - 0.5 * y
    assert over.min() > -1e-9
    assert mean(X, over) < 0.005


@pytest.mark.second
def test_a_narrow_peak_costs_what_it_is_wide():
    # Tops of ten modes of hardly any damping beside a flat floor: a plateau over them and no more.
    omega = np.exp(X)
    x = np.union1d(X, np.log(5 + 0.05 * np.arange(10)))
    tops = (1 - np.exp(2 * (x[:, None] - np.log(5 + 0.05 * np.arange(10))))) ** 2 + 1e-6
    y = np.logaddexp(0.0, -np.log(tops.min(axis=1)))
    v = np.array([y.max()])
    for states in (0, 2, 4, 6):
        v = with_two_states_more(v, x, y, states)
    W = realisation(v)
    assert omega[0] > 0
    assert W.poles().real.max() < 0
    assert mean(x, np.log(np.abs(W.response(np.exp(x))[:, 0, 0])) - 0.5 * y) < np.log(1.5)
