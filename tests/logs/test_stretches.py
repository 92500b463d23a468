import numpy as np
import pytest

from casid import Record
from casid.logs.stretches import LONGEST, find_stretches, left_out

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


def hovering(*flown, seed=0, gusts=0.5):
    """w' = az = -0.6 (w - g) - 24 thrust, thrust = 0.05 w + 0.2 ∫w and a sweep in spans [s].

    Sticks and rates move from 90 to 104 s and rest elsewhere. g are gusts, az and w have noise.
    """
    rng, dt = np.random.default_rng(seed), 0.02
    noise = rng.standard_normal((4, len(T)))
    sweep = np.zeros(len(T))
    for a, b in flown:
        s = T[on := (a < T) & (b > T)] - a
        sweep[on] = 0.06 * np.sin(2.5 * s + 0.8 * s**2) * np.minimum(1, np.minimum(s, b - a - s))
    w, g, held = 0.0, 0.0, 0.0
    thrust, az, speed = np.zeros((3, len(T)))
    for k in range(len(T)):
        g += -dt * g + gusts * np.sqrt(2 * dt) * noise[0, k]
        speed[k] = w + 0.02 * noise[1, k]
        held += 0.2 * speed[k] * dt
        thrust[k] = 0.05 * speed[k] + held + sweep[k]
        az[k] = -0.6 * (w - g) - 24 * thrust[k]
        w += dt * az[k]
    moving = (T > 90) & (T < 104)
    stick = 0.05 * np.sin(2 * T) * moving + 1e-3 * noise[2]
    rates = np.outer(0.5 * np.sin(2 * T - 1) * moving, [1, 0.4, 0.2])
    rates += 3e-3 * rng.standard_normal(rates.shape)
    y = np.column_stack([rates, az + 0.1 * noise[3], speed])
    names = ("roll", "thrust"), (*"pqr", "az", "w")
    return Record(T, np.column_stack([stick, thrust]), y, *names, "flight")


def seen(found, *instants):
    return [any(x.record.t[0] <= at <= x.record.t[-1] for x in found) for at in instants]


@pytest.mark.parametrize("known", [("az",), ("w",), ("az", "w")])
def test_a_collective_that_is_flown_is_answered_by_what_it_lifts(known):
    flight = hovering((20, 28), (50, 58)).select(outputs=(*"pqr", *known))
    found = find_stretches([flight])
    assert seen(found, 24, 54, 97, 10, 40, 75, 115) == [True] * 3 + [False] * 4
    assert left_out([flight], found) == ()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gusts", [0.1, 1.5])
def test_a_hover_that_is_held_is_no_candidate_and_nothing_is_told_of_it(seed, gusts):
    flight = hovering(seed=seed, gusts=gusts)
    found = find_stretches([flight])
    assert seen(found, 97, *range(5, 85, 5), 115) == [True] + [False] * 17
    assert left_out([flight], found) == ()


def test_what_is_flown_and_stands_in_no_stretch_is_told():
    flight = hovering((20, 28), (50, 58)).select(outputs=tuple("pqr"))
    (said,) = left_out([flight], find_stretches([flight]))
    assert said.startswith(
        "thrust is moved at 20-28 and 50-58 s, the rates rest and the log has no"
    )
    stick, said = left_out([hovering((20, 28))], [])
    assert stick.startswith("roll is moved at 90-104 s, and the rates do not answer")
    assert said.startswith("thrust is moved at 20-28 s, the rates rest and it makes less than half")
    stick, rate = record((20, 40)), record((60, 90))
    (said,) = left_out([Record(T, stick.u, rate.y, ("roll",), ("p",), "x")], [])
    assert said.startswith("roll is moved at 20-40 s, and the rates do not answer")
    assert left_out([], []) == ()
