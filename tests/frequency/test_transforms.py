"""Where losses part a record, and where its channels are sampled in turns."""

import dataclasses

import numpy as np
import pytest
from truths.systems import LAG, TWO, white

from casid.frequency.local import local_response
from casid.frequency.transforms import lines_at


def test_long_losses_part_a_record_and_short_ones_do_not():
    record = white(LAG, np.random.default_rng(2), duration=60.0)
    y = record.y.copy()
    y[100:104] = y[600:640] = np.nan  # 0.2 s and 2 s
    omega, holed = np.array([1.0, 2.0, 5.0]), dataclasses.replace(record, y=y)
    apart = lines_at([holed], omega, 0)
    assert [len(each) for each in apart] == [1, 1, 2]  # periods of 6, 3 and 1.3 s
    assert [each.omega[0] for each in apart[2]] == [
        pytest.approx(2 * np.pi / (n * record.dt)) for n in (600, record.N - 640)
    ]
    found = local_response([holed], omega)
    assert np.abs(found.G / LAG.response(omega) - 1).max() < 0.05


def test_channels_whose_samples_never_coincide_are_one_record():
    record = white(TWO, np.random.default_rng(2), duration=60.0)
    k, y = np.arange(record.N), record.y.copy()
    y[k % 2 == 0, 0], y[k % 4 != 0, 1] = np.nan, np.nan
    omega, slower = np.array([0.5, 3.0]), dataclasses.replace(record, y=y)
    assert np.isnan(y).any(axis=1).all()
    assert [len(each) for each in lines_at([slower], omega, 0)] == [1, 1]
    both = [local_response([each], omega) for each in (record, slower)]
    np.testing.assert_allclose(both[1].G, both[0].G, rtol=0.05, atol=0.01)
