"""Pieces of the reconstruction: noise on a smooth signal, and total values of a record."""

import numpy as np
import pytest
from truths.flights import flight

from casid.consistency.flightpath import looked_at, noise, signals

T = 0.02 * np.arange(5000)


def test_noise_is_that_of_white_noise_whatever_the_signal_and_a_few_outliers():
    rng = np.random.default_rng(0)
    x = np.sin(T) + 0.01 * rng.standard_normal(5000)
    # 5000 third differences, correlated over three: 0.01 ± 0.0002.
    assert noise(x) == pytest.approx(0.01, rel=0.05)
    x[rng.integers(0, 5000, 5)] += 0.5
    assert noise(x) == pytest.approx(0.01, rel=0.05)
    repeated = np.repeat(rng.standard_normal(500), 10)  # most differences are zero
    assert noise(repeated) > 0.1


def test_total_values_come_back_and_speed_becomes_velocities():
    record = flight(0)
    trimmed = record.detrend("first")
    whole = signals(trimmed, {})
    np.testing.assert_allclose(whole.values["theta"], record.channel("theta"), atol=1e-12)
    u, v, w = (record.channel(name) for name in "uvw")
    V = np.sqrt(u**2 + v**2 + w**2)
    air = np.column_stack([V, np.arctan2(w, u), np.arcsin(v / V), record.channel("p")])
    seen = type(record)(record.t, record.u, air, ("lat",), ("V", "alpha", "beta", "p"))
    for name, true in zip("uvw", (u, v, w), strict=True):
        np.testing.assert_allclose(signals(seen, {}).values[name], true, atol=1e-9)
    assert "phi" not in signals(record.mask(np.ones(record.y.shape, dtype=bool)), {}).values


def test_long_records_are_looked_at_in_part_and_short_pieces_not_at_all():
    record = flight(0)
    assert [each.N for each in looked_at([record, record.take(slice(10))])] == [record.N]
