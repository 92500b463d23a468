import sys

import numpy as np
import pytest
from truths.systems import campaign

from casid import Record
from casid.records import standard_deviations
from casid.subspace.columns import (
    _ends_of_power,
    check_independent,
    completed,
    excited_band,
    feedthrough_mask,
    gather,
    pieces_of,
)


def test_stack_of_blocks_is_the_stack_of_all_columns(monkeypatch):
    records = campaign(noise=0.02)
    su, sy = standard_deviations(records)
    whole, _ = gather(records, su, sy, 6, 6.0)
    monkeypatch.setattr(sys.modules["casid.subspace.columns"], "BLOCK", 100)
    parts, _ = gather(records, su, sy, 6, 6.0)
    assert parts.columns == whole.columns
    np.testing.assert_allclose(parts.R.T @ parts.R, whole.R.T @ whole.R, rtol=1e-9, atol=1e-8)


def test_band_spans_what_every_input_excites():
    t = np.arange(0, 60, 0.02)
    fast, slow = np.sin(6.0 * t), np.sin(2.0 * t)
    y = np.zeros((len(t), 1))
    low, high = excited_band([Record(t, np.column_stack([fast, slow]), y, ("f", "s"), ("y",))])
    assert low == pytest.approx(4 * np.pi / t[-1])
    assert 2.0 <= high < 3.0


def test_power_ends_where_the_faster_of_two_sines_is_needed():
    t = np.arange(0, 100, 0.05)
    x = np.sqrt(0.8) * np.sin(2.0 * t) + np.sqrt(0.2) * np.sin(7.0 * t)
    y = np.where(np.arange(len(t)) % 2, np.nan, x)  # measured at every other instant
    flown = [Record(t, x[:, None], y[:, None], ("u",), ("y",), name) for name in "ab"]
    for letter in "uy":
        for part, end in ((0.7, 2.0), (0.9, 7.0)):
            assert _ends_of_power(flown, letter, part) == [pytest.approx(end, rel=0.03)]


def test_pieces_lie_between_long_gaps():
    t, y = 0.1 * np.arange(100), np.zeros((100, 1))
    y[30:60] = np.nan
    y[80] = np.nan
    record = Record(t, np.zeros((100, 1)), y, ("u",), ("y",))
    spans = [(p.t[0], p.t[-1], n) for p, n in pieces_of(record, completed(record), 2.0)]
    np.testing.assert_allclose(spans, [(0.0, 2.9, 0), (6.0, 9.9, 1)])


@pytest.mark.parametrize("kind", ["input", "output"])
def test_a_channel_that_is_the_sum_of_two_others_is_named_with_them(kind):
    rng, t = np.random.default_rng(0), 0.1 * np.arange(60)
    sound, x = rng.standard_normal((60, 3)), rng.standard_normal((60, 3))
    x[:, 2] = x[:, 0] - 2 * x[:, 1]
    both = (x, sound) if kind == "input" else (sound, x)
    check_independent([Record(t, sound, sound, tuple("abc"), tuple("xyz"))])
    names = "a and b and c" if kind == "input" else "x and y and z"
    with pytest.raises(ValueError, match=f"{kind}s {names} depend on one another"):
        check_independent([Record(t, *both, tuple("abc"), tuple("xyz"))])


def test_mask_is_built_from_every_accepted_form():
    inputs, outputs = ("a", "b"), ("x", "y")
    assert feedthrough_mask(True, inputs, outputs).all()
    assert not feedthrough_mask(False, inputs, outputs).any()
    np.testing.assert_array_equal(
        feedthrough_mask(["y"], inputs, outputs), [[False, False], [True, True]]
    )
    with pytest.raises(ValueError, match="feedthrough names no output 'q'"):
        feedthrough_mask(["q"], inputs, outputs)
    with pytest.raises(ValueError, match="expected \\(2, 2\\)"):
        feedthrough_mask(np.ones((1, 2), dtype=bool), inputs, outputs)
