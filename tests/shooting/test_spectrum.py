"""Spectra of residuals."""

from types import SimpleNamespace

import numpy as np
import pytest
from truths.closed_roll import (
    NOISE,
    TRUTH,
    campaign,
)

from casid import (
    output_error,
)
from casid.shooting.spectrum import reach, smoothed, weighed_apart

CLEAN = campaign()


@pytest.mark.second
def test_spectra_are_those_of_the_noise():
    found = output_error(TRUTH, campaign(3), domain="frequency").notes.spectra
    assert [each.records for each in found] == [("record 0", "record 1", "record 2")]
    power = found[0].power / [NOISE[name] ** 2 for name in TRUTH.outputs]
    assert np.all((power > 0.5) & (power < 2.0))
    np.testing.assert_allclose(power[-10:].mean(axis=0), 1.0, atol=0.1)


def test_smoothing_keeps_a_flat_spectrum_and_widens_where_lines_are_few():
    omega = np.arange(1.0, 301.0)
    power, freedom = np.full(300, 6.0), np.full(300, 2.0)
    np.testing.assert_allclose(smoothed(omega, power, freedom, omega), 3.0)
    power = np.where(omega > 100, 8.0, 2.0)
    found = smoothed(omega, power, freedom, np.array([1.0, 60.0, 150.0]))
    np.testing.assert_allclose(found, [1.0, 1.0, 4.0])


@pytest.mark.parametrize(
    ("share", "from_there"), [(0.05, 9.0), (0.3, 4.0), (0.6, 3.0), (2.0, 1.0), (9.0, 1.0)]
)
def test_the_reach_is_where_the_lines_above_hold_a_share(share, from_there):
    omegas, taken = ([1.0, 4.0], [3.0, 9.0]), ([[1.0, 0.5], [0.2, 0.1]], [[0.25, 0.0], [0.1, 0.0]])
    lines = [SimpleNamespace(omega=np.array(omega)) for omega in omegas]
    # from above: 0.1 at 9, 0.3 at 4, 0.25 at 3, 1.5 at 1 rad/s
    assert reach(lines, [np.array(h) for h in taken], share) == from_there


def test_of_kinds_weighed_by_what_was_measured_of_each_the_mean_scatters_as_told():
    # Means of unit variance of three kinds, weighed by variances of twelve degrees of freedom.
    rng, freedom, draws = np.random.default_rng(3), 12, 40000
    v = rng.chisquare(freedom, (draws, 3)) / freedom
    mean = np.sum(rng.standard_normal((draws, 3)) / v, axis=1) / np.sum(1 / v, axis=1)
    stated = np.mean(1 / np.sum(1 / v, axis=1))
    lines = [SimpleNamespace(kind=k, weight=np.full(6, 2.0)) for k in range(3)]
    shares = [np.full((6, 1), 0.3)] * 3
    found = weighed_apart(lines, shares, 1.0)
    np.testing.assert_allclose(found, 1 + 4 * 3 * (1 / 3) * (2 / 3) / freedom)
    np.testing.assert_allclose(found, np.mean(mean**2) / stated, rtol=0.05)
    np.testing.assert_array_equal(weighed_apart(lines[:1], shares[:1], 1.0), 1)
