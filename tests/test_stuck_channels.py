"""Stuck and copied stretches put into flights, and honest channels that look a little like them."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.ndimage
from truths import bodies, uh60

from casid import Record, read_csv
from casid.stuck_channels import frozen

STEPS = np.array([uh60.NOISE[name] for name in uh60.OUTPUTS])


def flown(name="3211_lat", seed=None):
    columns = {"inputs": uh60.INPUTS, "outputs": uh60.OUTPUTS}
    record = read_csv(uh60.EXAMPLE / "data" / f"{name}.csv", **columns)
    if seed is None:
        return record
    return record.with_noise(uh60.NOISE, np.random.default_rng(seed))


def put(record, name, rows, values):
    y = record.y.copy()
    y[rows, record.outputs.index(name)] = values
    return replace(record, y=y)


def test_a_sensor_that_stops_is_named_with_its_place():
    record = flown(seed=1)
    p = record.channel("p")
    (found,) = frozen(put(record, "p", slice(150, 200), p[150]))
    assert (found.channel, found.source) == ("p", None)
    assert (found.start, found.duration) == pytest.approx((record.t[150], 49 * 0.02))
    assert found.told().startswith("p stands still from 3 s for 0.98 s while all else moves")
    (found,) = frozen(put(record, "phi", slice(300, None), record.channel("phi")[300]))
    assert (found.channel, found.start) == ("phi", pytest.approx(record.t[300]))


def test_a_copied_block_is_named_with_its_source():
    record = flown(seed=2)
    ay = record.channel("ay")
    (found,) = frozen(put(record, "ay", slice(400, 430), ay[100:130]))
    place = (found.channel, found.start, found.duration, found.source)
    assert place == ("ay", *map(pytest.approx, (record.t[400], 29 * 0.02, record.t[100])))
    assert "exactly what it was at" in found.told()
    # Of ten samples alike nothing is said where ten could be alike by chance.
    coarse = replace(record, y=np.round(record.y / (4 * STEPS)) * 4 * STEPS)
    assert not frozen(put(coarse, "ay", slice(400, 410), coarse.channel("ay")[100:110]))


def held(record):
    return replace(record, y=record.y[np.arange(record.N) // 4 * 4])


def counted(record):
    return replace(record, y=np.round(record.y / (3 * STEPS)) * 3 * STEPS)


def lost(record):
    return record.mask(np.random.default_rng(3).random(record.y.shape) < 0.2)


def slower(record):
    return record.mask(np.arange(record.N)[:, None] % [1, 1, 1, 1, 1, 1, 4, 4] != 0)


@pytest.mark.parametrize("honest", [held, counted, lost, slower, lambda r: held(counted(r))])
@pytest.mark.parametrize("seed", [None, 4])
def test_slow_counted_and_held_channels_are_honest(honest, seed):
    assert not frozen(flown(seed=seed))
    assert not frozen(honest(flown(seed=seed)))


def test_a_periodic_motion_is_no_copy():
    k = np.arange(1000)
    turn = np.round(np.sin(2 * np.pi * (k % 50) / 50), 6)[:, None]
    assert not frozen(Record(0.02 * k, turn, turn, ("lat",), ("p",), "periodic"))


def steered(seed, noise=0.0005):
    """A flight whose lateral stick never rests: a hand, and noise."""
    record = flown(seed=seed)
    rng = np.random.default_rng(seed)
    hand = 0.02 * np.sin(1.3 * record.t + seed) + 0.01 * np.sin(3.1 * record.t)
    return replace(record, u=record.u + hand[:, None] + noise * rng.standard_normal(record.u.shape))


def with_input(record, rows, values):
    u = record.u.copy()
    u[rows, 0] = values
    return replace(record, u=u)


@pytest.mark.parametrize("noise", [0.0, 0.0005])
def test_an_input_that_stops_amid_movement_is_named(noise):
    record = steered(5, noise)
    assert not frozen(record)
    (found,) = frozen(with_input(record, slice(310, 410), record.u[310, 0]))
    assert (found.channel, found.lost) == (record.inputs[0], "input")
    assert (found.start, found.duration) == pytest.approx((record.t[310], 99 * 0.02))
    assert "leave these rows out" in found.told()


def test_a_copied_block_of_a_noisy_input_is_named():
    record = steered(6)
    (found,) = frozen(with_input(record, slice(400, 440), record.u[100:140, 0]))
    assert (found.channel, found.source, found.lost) == (
        record.inputs[0],
        pytest.approx(record.t[100]),
        "input",
    )


def test_a_stall_of_the_logger_is_named_once():
    record = steered(7)
    u, y = record.u.copy(), record.y.copy()
    u[300:340], y[300:340] = u[300], y[300]
    (found,) = frozen(replace(record, u=u, y=y))
    assert (found.lost, found.start) == ("rows", pytest.approx(record.t[300]))
    assert found.duration == pytest.approx(39 * 0.02)
    assert found.told().startswith("all channels stand still from 6 s for 0.78 s")


def ramps(t):
    return np.interp(t, [2, 2.3, 4, 4.5, 6, 6.2, 8, 9], [0, 0.1, 0.1, -0.2, -0.2, 0.05, 0.05, 0])


def levels(t):
    return np.select([t < 2, t < 4, t < 5, t < 7], [0.0, 0.1, -0.13, 0.05], 0.0)


def quantised(t):
    return np.round(0.1 * np.sin(2 * t) / 0.004) * 0.004


def held_at_five_hertz(t):
    return 0.1 * np.sin(2 * np.floor(5 * t) / 5)


@pytest.mark.parametrize("command", [ramps, levels, quantised, held_at_five_hertz])
def test_commands_that_rest_by_themselves_are_honest(command):
    record = flown(seed=8)
    assert not frozen(with_input(record, slice(None), command(record.t)))


@pytest.mark.parametrize(("rows", "called"), [(9, False), (10, True)])
def test_a_stall_is_ten_repeated_rows(rows, called):
    record = steered(7)
    u, y = record.u.copy(), record.y.copy()
    u[301 : 301 + rows], y[301 : 301 + rows] = u[300], y[300]
    assert [each.lost for each in frozen(replace(record, u=u, y=y))] == ["rows"] * called


def test_an_output_that_rests_with_its_input_is_not_stuck():
    rng, t = np.random.default_rng(4), 0.02 * np.arange(900)
    levels = np.repeat([0.0, 1.0, -0.4, 0.3, -1.0, 0.1, 0.6, -0.2, 0.4], 100)
    levels += 0.05 * rng.standard_normal(900) * (np.arange(900) // 100 % 2 == 0)  # or at rest
    noisy = np.cumsum(rng.standard_normal(900))
    u, y = np.column_stack([levels, noisy]), np.column_stack([2 * levels, noisy + levels])
    assert not frozen(Record(t, u, y, ("lat", "lon"), ("p", "q"), "steps"))


@pytest.mark.parametrize(("length", "least", "most"), [(17, 0, 0), (22, 7, 10)])
def test_a_block_is_a_copy_if_chance_repeats_it_once_in_a_thousand_records(length, least, most):
    # Of 1000 throws of three equal levels, a given pair of blocks of L is equal with 3^-L: among
    # n² pairs of starts one in a thousand records from L = log3(1000 n²) = 18.9 on. A word of it
    # that stands between both by chance, in 7 % of records, hides the copy.
    called = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        x = rng.integers(0, 3, 1000).astype(float)
        x[600 : 600 + length] = x[570 : 570 + length]
        x[599], x[600 + length] = (x[569] + 1) % 3, (x[570 + length] + 1) % 3
        y = np.column_stack([x, rng.standard_normal(1000)])
        u = rng.standard_normal((1000, 1))
        found = frozen(Record(0.02 * np.arange(1000), u, y, ("lat",), ("p", "q"), "throws"))
        assert {round(each.start / 0.02) for each in found} <= {600}
        called += len(found)
    assert least <= called <= most


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_stick_that_leaves_its_way_for_a_few_samples_is_named(count, axis):
    record = flown(seed=3)
    u = record.u.copy()
    u[120 : 120 + count, axis] += 0.7 * np.ptp(record.u[:, 1])
    (found,) = frozen(replace(record, u=u))
    assert (found.channel, found.dart, found.lost) == (record.inputs[axis], True, "input")
    assert (found.start, found.duration) == pytest.approx((record.t[120], 0.02 * count))
    assert found.told().startswith(f"{record.inputs[axis]} jumps away from 2.4 s for")


def test_sticks_that_are_moved_quickly_do_not_dart():
    record, rng = flown(seed=4), np.random.default_rng(4)
    for more in (
        np.where(np.arange(record.N) % 100 < 6, 1.0, 0.0),  # pulses of 0.12 s
        rng.standard_normal(record.N),  # a controller and a noisy sensor
        np.sin(np.arange(record.N) ** 2 * 2e-3),  # a sweep beyond what the sampling shows
        1.0 * (rng.random(record.N) < 0.5),
    ):
        u = record.u + more[:, None] * [0, 0.1, 0, 0]
        assert not any(each.dart for each in frozen(replace(record, u=u)))


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1 / 0.7])
def test_single_counts_of_a_counted_stick_are_no_darts_but_lost_samples_are(unit):
    record, rng = flown(seed=5), np.random.default_rng(5)
    x = 1500 + np.round(1.2 * np.sin(0.7 * record.t) + 0.05 * rng.standard_normal(record.N))
    quiet = np.flatnonzero(scipy.ndimage.minimum_filter(np.diff(x, append=x[-1]) == 0, 25))
    single = quiet[::40][1:-1]
    x[single] -= 1  # the last bit of what a controller commands, back at once
    assert len(single) > 3

    def told(x):
        u = np.column_stack([x * unit, *record.u.T[1:]])
        return [each.start for each in frozen(replace(record, u=u)) if each.dart]

    assert told(x) == []
    x[quiet[50]] += 40
    assert told(x) == [pytest.approx(record.t[quiet[50]])]
    rest = np.full(record.N, 1500.0)  # no count is known of what moves by nothing else
    rest[[200, 500]] = 0.0
    assert told(rest) == [pytest.approx(record.t[200]), pytest.approx(record.t[500])]


IMU = (*bodies.RATES, *bodies.FORCES)


def looped(seed, lost=0.0):
    """A flight whose sticks are what a controller makes of noisy rates and attitudes."""
    (record,) = bodies.flown(seed, "hover" if seed % 2 else "cruise", count=1)
    p, q, phi, theta = (record.channel(name) for name in ("p", "q", "phi", "theta"))
    u = np.column_stack([0.5 * p + 0.8 * phi, 0.5 * q + 0.8 * theta])
    record = replace(record, u=u, inputs=("lat", "lon"))
    return record.mask(np.random.default_rng(seed).random(record.y.shape) < lost)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("lost", [0.0, 0.01])
@pytest.mark.parametrize("rows", [10, 20, 50])
@pytest.mark.parametrize("zero", [True, False])
def test_an_inertial_unit_that_is_lost_is_named_whole_and_once(rows, zero, lost):
    for seed in range(600, 604):
        record = looped(seed, lost)
        assert not frozen(record)
        k = int(np.random.default_rng([seed, rows]).integers(150, 700))
        y = record.y.copy()
        own = [record.outputs.index(name) for name in IMU]
        y[k : k + rows, own] = 0.0 if zero else 1.0 + np.arange(6)
        (found,) = frozen(replace(record, y=y))
        assert found.channel == "p q r ax ay az"
        assert (found.lost, found.zero) == ("output", zero)
        assert (found.start, found.duration) == pytest.approx((record.t[k], 0.02 * (rows - 1)))
        words = "are zero from" if zero else "stand still from"
        assert found.told().startswith(f"p q r ax ay az {words} {record.t[k]:.4g} s for")


def test_two_channels_that_rest_at_once_or_six_for_a_moment_are_no_lost_source():
    record = looped(605)
    for names, rows in (IMU[:2], 12), (IMU, 6):
        y = record.y.copy()
        y[300 : 300 + rows, [record.outputs.index(name) for name in names]] = 0.0
        assert not any(" " in each.channel for each in frozen(replace(record, y=y)))
