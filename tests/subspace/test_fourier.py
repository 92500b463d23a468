from math import factorial

import numpy as np
import pytest
from truths.systems import campaign

from casid import Record
from casid.records import standard_deviations
from casid.subspace.fourier import _hold_weights, parts, spectra


def test_a_long_record_is_transformed_in_pieces_of_limited_size(monkeypatch):
    record = campaign(records=1, duration=30.0)[0]
    su, sy = standard_deviations([record])
    assert len(spectra([record], su, sy, 10.0)) == 1
    several = spectra([record] * 2, su, sy, 2 * np.pi * 1200 / record.duration)
    assert len(several) == 6  # 1200 lines in pieces of 500 at most
    assert all(len(each.omega) <= 500 for each in several)
    assert [each.omega[0] for each in several] == pytest.approx(
        [6 * np.pi / record.duration] * 6, rel=0.01
    )
    monkeypatch.setattr("casid.subspace.fourier.SAMPLES", record.N / 4)
    assert len(spectra([record], su, sy, 10.0)) == 4


def test_a_stretch_too_short_for_a_line_is_left_out():
    record = campaign(records=1, duration=30.0)[0]
    su, sy = standard_deviations([record])
    short = record.take(slice(0, 3))
    both = spectra([short, record], su, sy, top=10.0)
    assert [len(each.omega) for each in both] == [
        len(each.omega) for each in spectra([record], su, sy, top=10.0)
    ]


def test_a_record_of_twice_a_fast_length_is_halved():
    t, none = 0.01 * np.arange(2 * 11_664 + 1), np.zeros((2 * 11_664 + 1, 1))  # 2⁴ 3⁶
    pieces = parts(Record(t, none, none, ("lat",), ("p",)), 1.0)
    assert [each.N - 1 for each in pieces] == [11_664, 11_664]


@pytest.mark.parametrize("samples", [27_198, 49_999, 200_003])
def test_pieces_meet_at_one_sample_and_have_lengths_without_large_primes(samples):
    t, none = 0.01 * np.arange(samples), np.zeros((samples, 1))
    pieces = parts(Record(t, none, none, ("lat",), ("p",)), 1.0)
    assert [each.t[0] for each in pieces[1:]] == [each.t[-1] for each in pieces[:-1]]
    assert (pieces[0].t[0], pieces[-1].t[-1]) == (t[0], t[-1])
    for each in pieces[:-1]:
        assert 30**20 % (each.N - 1) == 0  # 2, 3 and 5 only
        assert each.N < 12_400
    assert len(pieces[-1].t) < 18_000


@pytest.mark.parametrize("size", [1e-3, 0.0099, 0.0101, 0.5, 2.0])
def test_weights_of_held_inputs_are_their_power_series(size):
    # φ₁ = Σ xⁿ/(n+1)! of both samples, φ₂ = Σ xⁿ/(n+2)! of the later one. Below 0.01 four terms
    # are kept, three of derivatives: what is left out is x⁴/120 and x³/30.
    x, n = size * np.exp(1j * np.array([0.0, 1.0, 2.5, np.pi])), np.arange(40)
    powers, slopes = x[:, None] ** n, n[1:] * x[:, None] ** (n[1:] - 1)
    one, two = (np.array([1 / factorial(k + more) for k in n]) for more in (1, 2))
    for hold, early, late in (("zoh", one, 0 * one), ("foh", one - two, two)):
        values, derivatives = _hold_weights(x, hold)
        np.testing.assert_allclose(values, [powers @ early, powers @ late], rtol=0, atol=1e-10)
        exact = [slopes @ early[1:], slopes @ late[1:]]
        np.testing.assert_allclose(derivatives, exact, rtol=0, atol=4e-8)
