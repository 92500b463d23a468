"""Records cut into intervals."""

from dataclasses import replace

import numpy as np
from truths.closed_roll import flown, with_holes

from casid import Record
from casid.shooting.intervals import lay_out


def test_intervals_cover_every_sample_once():
    records = [flown(seed=1), with_holes(flown(seed=2).between(0, 5)), flown(seed=3)]
    layout = lay_out(records, 0.7)
    covered = np.concatenate(
        [np.arange(a, a + n) for a, n in zip(layout.start, layout.count, strict=True)]
    )
    np.testing.assert_array_equal(np.sort(covered), np.arange(sum(r.N for r in records)))
    assert (np.diff(layout.count) <= 0).all()
    assert np.bincount(layout.record).tolist() == [round(r.duration / 0.7) for r in records]
    assert layout.last.sum() == len(records)
    assert layout.observations == sum(int(np.isfinite(r.y).sum()) for r in records)


def test_steps_are_the_distances_of_samples():
    t = np.array([0.0, 0.1, 0.2, 0.4, 0.5, 0.9])
    layout = lay_out([Record(t, t[:, None], t[:, None], ("u",), ("y",))], 10.0)
    np.testing.assert_allclose(layout.classes[layout.step], [0.1, 0.1, 0.2, 0.1, 0.4, 0.4])


def test_patterns_are_the_distinct_ones_the_complete_one_first():
    record = flown(seed=1).take(slice(0, 40))
    y = record.y.copy()
    y[:10, 0], y[5:15, 1], y[20, :] = np.nan, np.nan, np.nan
    layout = lay_out([replace(record, y=y)], 10.0)
    assert layout.patterns[0].all()
    np.testing.assert_array_equal(layout.patterns[layout.pattern], np.isfinite(y))
    assert len(layout.patterns) == len({tuple(row) for row in np.isfinite(y)})
