import numpy as np

from casid import Record
from casid.logs.stretches import LONGEST, find_stretches

T = 0.02 * np.arange(6000)  # 120 s
rng = np.random.default_rng(2)


def record(*flown, name="flight 1"):
    """Stick and rate that move in spans [s], and rest with a little noise elsewhere."""
    moving = np.any([(a <= T) & (b >= T) for a, b in flown], axis=0)
    wave = np.sin(3 * T) * moving
    noise = 1e-3 * rng.standard_normal((2, len(T)))
    return Record(
        T, (wave + noise[0])[:, None], (2 * wave + noise[1])[:, None], ("roll",), ("p",), name
    )


def test_what_moves_is_found_with_a_quiet_edge():
    found = find_stretches([record((20, 32), (60, 75))])
    spans = [(each.record.t[0], each.record.t[-1]) for each in found]
    assert len(spans) == 2
    for (start, end), (a, b) in zip(spans, [(20, 32), (60, 75)], strict=True):
        assert a - 4 <= start < a
        assert b < end <= b + 4
    assert [each.record.name for each in found] == ["flight_1", "flight_2"]
    np.testing.assert_allclose([each.moved[0] for each in found], 0.6, atol=0.1)


def test_long_stretches_are_cut_and_slow_drift_is_no_movement():
    assert find_stretches([record((0, 120))])[0].record.duration <= LONGEST
    still = record((20, 30))
    drifting = Record(T, still.u + T[:, None], still.y + T[:, None], ("roll",), ("p",), "x")
    (found,) = find_stretches([drifting])
    assert found.record.t[0] > 15


def test_sticks_that_move_nothing_are_no_candidate():
    stick, rate = record((20, 40)), record((60, 90))
    assert find_stretches([Record(T, stick.u, rate.y, ("roll",), ("p",), "x")]) == []
    assert find_stretches([]) == []


def test_wild_samples_are_no_measure_of_what_moves():
    # One, and a dropout to what a sensor says where it has nothing to say.
    sound = record((20, 32), (60, 75))
    spans = [(each.record.t[0], each.record.t[-1]) for each in find_stretches([sound])]
    for rows in (slice(1300, 1301), slice(1300, 1320)):
        y = sound.y.copy()
        y[rows] = -999.0
        found = find_stretches([Record(T, sound.u, y, ("roll",), ("p",), "flight 1")])
        assert [(each.record.t[0], each.record.t[-1]) for each in found] == spans
