from dataclasses import replace

import numpy as np
import pytest
import scipy
from truths.logs import LATE, RATES, STICKS, flight, ulog

from casid import StateSpace, read_csv, read_log, write_csv
from casid.logs.assembly import (
    _means,
    _picked,
    assemble,
    hold_doubt,
    hold_of,
    hold_told,
    in_steps,
    lateness,
    stepped,
    usual_dt,
)
from casid.logs.conventions import derived, find_channels, others
from casid.logs.sources import Source
from casid.logs.topics import Topic

LAGS = np.arange(-0.02, 0.03, 0.001)


def channels(tmp_path, **options):
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(**options))
    log = derived(read_log(path))
    return log, *find_channels(log)


def source(t, x, name="T", age=0.0):
    topic = Topic(name=name, t=t, columns={"x": x}, age=age)
    return Source(place=f"{name}.x", topic=topic, values=x)


def test_a_record_holds_the_flight_on_one_clock(tmp_path):
    _, inputs, outputs = channels(tmp_path, seconds=20.0)
    assert usual_dt(inputs, outputs) == 0.01
    (record,) = assemble(inputs, outputs, 0.02, "flight")
    t, x = flight(20.0)
    at = record.t - 100
    for name in STICKS:  # filtered, which rounds the corners of steps of 0.1 by a few per cent
        np.testing.assert_allclose(record.channel(name), np.interp(at, t, x[name]), atol=6e-3)
    inside = slice(20, -20)  # the filter's ends
    for name in ("phi", "theta"):
        wanted = np.interp(at, t, x[name])
        np.testing.assert_allclose(record.channel(name)[inside], wanted[inside], atol=2e-3)
    for name in RATES:
        left = record.channel(name)[inside] - np.interp(at, t, x[name])[inside]
        assert left.std() < 0.004  # the gyros' noise is 0.003


def test_slower_channels_are_empty_between_their_samples(tmp_path):
    _, inputs, outputs = channels(tmp_path, seconds=8.0)
    (record,) = assemble(inputs, outputs, 0.01, "flight")
    known = np.isfinite(record.channel("phi"))
    assert known.mean() == pytest.approx(0.5, abs=0.01)  # 50 Hz in 100
    assert np.isfinite(record.channel("p")).mean() > 0.99


def test_a_logger_that_stops_makes_two_records(tmp_path):
    _, inputs, outputs = channels(tmp_path, seconds=20.0, lose=(8.0, 11.0))
    first, second = assemble(inputs, outputs, 0.02, "flight")
    assert first.t[-1] <= 108.0 + 1e-9
    assert second.t[0] >= 111.0 - 1e-9


def test_outputs_stand_when_they_were_sampled_and_inputs_when_they_were_sent():
    t = np.arange(0, 10, 0.01)
    inputs = {"roll": source(t, np.sin(t), "in", age=0.1)}
    outputs = {"p": source(t, np.cos(t), "out", age=0.1)}
    (record,) = assemble(inputs, outputs, 0.01, "x")
    np.testing.assert_allclose(record.channel("roll"), np.sin(record.t), atol=1e-4)
    inner = record.t < 9.8
    np.testing.assert_allclose(record.channel("p")[inner], np.cos(record.t[inner] + 0.1), atol=1e-6)


def test_topics_that_hold_the_same_tell_their_delay(tmp_path):
    log, _, outputs = channels(tmp_path, seconds=20.0)
    (found,) = [lateness(outputs["p"], each) for each in others(log, "p", outputs["p"])]
    assert found.late == "vehicle_attitude.rollspeed"
    assert found.seconds == pytest.approx(LATE, abs=1e-3)
    assert found.correlation > 0.95


def test_ages_that_the_log_states_are_no_delay():
    t, age = np.arange(0, 30, 0.01), 0.06
    x, y = (np.sin(1.3 * at) + 0.5 * np.sin(4.1 * at) for at in (t, t - age))
    stamped_late = source(t + age, x, "late", age=age)
    assert lateness(source(t, x), stamped_late).seconds == pytest.approx(0, abs=1e-3)
    assert lateness(source(t, x), source(t, y)).seconds == pytest.approx(age, abs=1e-3)


@pytest.mark.parametrize("level", [0.0, 0.3, 1500.0])
@pytest.mark.parametrize("every", [1, 4])
def test_an_input_rests_exactly_before_and_after_it_moves(level, every, tmp_path):
    t = 0.005 * np.arange(4000)  # 20 s, of which it moves for two
    x = level + np.where((t > 9) & (t < 11), np.sin(np.pi * (t - 9)), 0.0)
    x = x[np.arange(len(t)) // every * every]  # smooth, or held for a while
    inputs = {"yaw": source(t[::every], x[::every], "in")}
    outputs = {"r": source(t, np.maximum(x - level, 0.0), "out")}
    (record,) = assemble(inputs, outputs, 0.02, "flight")
    for part, rests in (((0.1, 8.5), True), ((11.5, 19.5), True), ((8.5, 11.5), False)):
        cut = record.cut(*part)
        assert (np.ptp(cut.channel("yaw")) == 0) == rests
        assert (np.ptp(cut.channel("r")) == 0) == rests
        write_csv(path := tmp_path / "x.csv", cut)
        again = read_csv(path, inputs=("yaw",), outputs=("r",))  # which takes no traces of a signal
        np.testing.assert_allclose(again.u, cut.u, rtol=1e-9)


def test_headings_that_pass_north_are_no_later_than_they_are():
    t, rng = np.arange(0, 60, 0.02), np.random.default_rng(3)
    psi = 0.1 + 0.25 * np.sin(0.3 * t) + 0.05 * np.sin(1.7 * t)
    one, other = (
        source(own, (at + 0.002 * rng.standard_normal(len(own))) % (2 * np.pi), name)
        for own, at, name in ((t, psi, "ATT"), (t[::5], psi[::5], "XKF1"))
    )
    assert abs(lateness(one, other).seconds) < 0.003


def test_one_lost_heading_is_one_lost_sample():
    t = np.arange(0, 20, 0.02)
    psi = (3.0 + 0.05 * t + np.pi) % (2 * np.pi) - np.pi  # beyond π after 2.8 s
    psi[400] = np.nan
    inputs, outputs = {"roll": source(t, np.sin(t), "in")}, {"psi": source(t, psi, "out")}
    (record,) = assemble(inputs, outputs, 0.02, "x")
    assert np.isfinite(record.channel("psi")).mean() > 0.99
    np.testing.assert_allclose(record.channel("psi")[:300], 3.0 + 0.05 * record.t[:300], atol=1e-9)


def test_topics_that_are_not_alike_have_no_delay():
    t, (a, b) = np.arange(0, 30, 0.02), np.random.default_rng(0).standard_normal((2, 1500))
    assert lateness(source(t, a), source(t, b)) is None
    assert lateness(source(t, a), source(t + 100, a)) is None  # no time in common


@pytest.mark.second
@pytest.mark.parametrize(("interval", "hold"), [(0.01, "zoh"), (0.005, "foh"), (0.0025, "foh")])
def test_delays_from_commands_in_steps_are_those_of_held_values(interval, hold):
    fine = 0.0005
    t = np.arange(0, 40, fine)
    own = np.floor(t / interval + 1e-6) * interval  # held from one sample to the next
    u = np.sign(np.sin(0.9 * own + 0.01 * own**2))
    truth = StateSpace(*([[x]] for x in (-4.0, 5.0, 1.0, 0.0)), delay=[0.08])
    y = truth.simulate(t, u[:, None], hold="zoh")[:, 0]
    every = round(interval / fine)
    inputs = {"u": source(t[::every], u[::every], "C")}
    outputs = {"p": source(t[::every], y[::every], "M")}
    (record,) = assemble(inputs, outputs, 0.01, "flight")
    assert record.hold == hold
    (said,) = hold_told(inputs, outputs, 0.01)
    assert said.endswith(f"delays would be half its interval, {500 * interval:.3g} ms, longer")
    tau = np.linspace(0.07, 0.09, 81)
    found = [_lag(truth, record, each) - record.y[:, 0] for each in tau]
    errors = [np.sum(each[200:-20] ** 2) for each in found]
    assert tau[np.argmin(errors)] == pytest.approx(0.08, abs=0.0006)


def slow(every, seconds=40.0, apart=0.0):
    """A lag of 80 ms driven by commands held for a while, seen 200 times a second; truth, channels.

    The commands' clock is off by ``apart`` intervals of the commands, at random.
    """
    fine, rng = 0.0005, np.random.default_rng(1)
    t = np.arange(0, seconds, fine)
    at = np.arange(0, seconds, every)
    at[1:] += every * apart * rng.uniform(-1, 1, len(at) - 1)
    at = fine * np.round(at / fine)
    commands = np.sign(np.sin(0.9 * at + 0.01 * at**2)) + 0.002 * rng.standard_normal(len(at))
    u = commands[np.searchsorted(at, t + fine / 2) - 1]
    truth = StateSpace(*([[x]] for x in (-4.0, 5.0, 1.0, 0.0)), delay=[0.08])
    y = truth.simulate(t, u[:, None], hold="zoh")[:, 0]
    inputs, outputs = {"u": source(at, commands, "C")}, {"p": source(t[::10], y[::10], "M")}
    return truth, inputs, outputs, (t, u)


@pytest.mark.parametrize("every", [0.01, 0.02, 0.04])
def test_commands_slower_than_the_gyros_stay_held(every):
    truth, inputs, outputs, _ = slow(every)
    dt = usual_dt(inputs, outputs)
    assert dt == 0.005
    (record,) = assemble(inputs, outputs, dt, "flight")
    assert record.hold == "zoh"
    wanted = truth.simulate(record.t, record.u, hold="zoh")
    np.testing.assert_allclose(record.y, wanted, atol=1e-9)
    (record,) = assemble(inputs, outputs, 0.01, "flight")  # the outputs filtered, the steps not
    assert record.hold == "zoh"
    own, held = inputs["u"].topic.t, inputs["u"].values
    np.testing.assert_array_equal(record.u[:, 0], held[np.searchsorted(own, record.t + 1e-9) - 1])
    wanted = truth.simulate(record.t, record.u, hold="zoh")
    np.testing.assert_allclose(record.y, wanted, atol=0.02 * np.std(wanted))


def test_commands_held_on_a_clock_of_their_own_have_the_area_of_their_steps():
    truth, inputs, outputs, (t, u) = slow(0.04, apart=0.2)
    assert usual_dt(inputs, outputs) == pytest.approx(0.005, rel=0.1)
    (record,) = assemble(inputs, outputs, 0.005, "flight")
    assert record.hold == "foh"
    area = np.interp(record.t + record.dt / 2, t, 0.0005 * (np.cumsum(u) - u))
    own = np.cumsum(record.u[:, 0]) * record.dt
    np.testing.assert_allclose(own - own[0], area - area[0], atol=1e-9)
    wanted = truth.simulate(record.t, record.u, hold="foh")
    assert np.std(record.y - wanted) < 0.004 * np.std(wanted)
    tau = np.linspace(0.078, 0.082, 41)
    errors = [np.sum((_lag(truth, record, each) - record.y[:, 0])[200:] ** 2) for each in tau]
    assert tau[np.argmin(errors)] == pytest.approx(0.08, abs=0.0003)


def test_records_of_held_commands_are_as_fast_as_gyros_down_to_five_milliseconds():
    _, inputs, outputs, _ = slow(0.04)
    fast = {"p": source(np.arange(0, 40, 0.0025), np.zeros(16_000), "M")}
    medium = {"p": source(np.arange(0, 40, 0.02), np.zeros(2000), "M")}
    assert [usual_dt(inputs, each) for each in (fast, outputs, medium)] == [0.005, 0.005, 0.02]


def test_commands_between_the_instants_of_a_record_are_no_held_ones():
    _, inputs, outputs, _ = slow(0.02)
    own = inputs["u"]
    other = source(own.topic.t + 0.0015, own.values, "other")  # 0.3 intervals of 5 ms
    assert hold_of(inputs, outputs, 0.005) == "zoh"
    assert hold_of(inputs | {"v": other}, outputs, 0.005) == "foh"
    assert hold_of(inputs | {"v": other}, outputs, 0.0015) == "foh"


def test_of_two_commands_at_one_instant_the_later_stays():
    t = np.append(0.02 * np.arange(30), 0.2008)  # another one 0.8 ms after the tenth
    x = np.append(np.arange(30.0), 77.0)
    order = np.argsort(t)
    found = _picked(source(t[order], x[order]), 0.01 * np.arange(58), 0.01)
    wanted = np.arange(58) // 2
    np.testing.assert_array_equal(found, np.where(wanted == 10, 77, wanted))


def test_means_of_a_held_signal():
    t = np.append(0.1 * np.arange(20), 0.1 * np.arange(30, 50))  # a second without samples
    x = np.where(np.arange(40) % 2, 1.0, 3.0)
    at = np.array([0.0, 0.05, 0.1, 0.12, 2.5, 3.02])
    np.testing.assert_allclose(_means(t, x, at, 0.08), [3, 3, 2, 1.5, np.nan, 2.5])
    assert np.isnan(_means(t[:8], x[:8], at, 0.08)).all()


def _lag(truth, record, tau):
    model = replace(truth, delay=np.array([tau]))
    return model.simulate(record.t, record.u, hold=record.hold)[:, 0]


def test_smooth_commands_are_lines():
    t = np.arange(0, 10, 0.01)
    command = source(t, np.sin(t))
    assert not in_steps(command)
    assert hold_of({"u": command}, {"p": command}, 0.01) == "foh"


def test_commands_logged_slower_than_they_were_made_are_half_an_interval_late_as_steps():
    """Jumps at any instant, logged every 20 ms: lines through samples have their area."""
    rng, t = np.random.default_rng(5), 0.02 * np.arange(2000)
    at = 1 + np.cumsum(rng.uniform(0.25, 0.65, 80))
    x = (np.searchsorted(at, t, side="right") % 2).astype(float)
    inputs = {"u": source(t, x)}
    fine = 0.001 * np.arange(40_000)
    outputs = {"p": source(fine[::5], np.sin(fine[::5]), "M")}
    found = {}
    for hold in ("zoh", "foh"):
        dt = usual_dt(inputs, outputs, hold)
        (record,) = assemble(inputs, outputs, dt, "flight", hold)
        assert record.hold == hold
        kind = {"zoh": "previous", "foh": "linear"}[hold]
        u = scipy.interpolate.interp1d(record.t, record.u[:, 0], kind, bounds_error=False)(fine)
        found[hold] = u
    inside = (fine > 0.5) & (fine < 39)
    own = (np.searchsorted(at, fine, side="right") % 2).astype(float)[inside]
    late = {}
    for hold, u in found.items():
        misses = [np.sum((u[inside] - np.interp(fine[inside] - lag, fine[inside], own)) ** 2)
                  for lag in LAGS]  # fmt: skip
        late[hold] = LAGS[int(np.argmin(misses))]
    assert late["zoh"] == pytest.approx(0.010, abs=0.002)
    assert late["foh"] == pytest.approx(0.0, abs=0.002)
    (said,) = hold_doubt(inputs)
    assert "20 ms apart" in said
    assert "some 10 ms, half an interval, longer" in said
    assert "--hold foh" in said
    assert hold_doubt(inputs, "foh") == []
    assert "shorter" in hold_told(inputs, outputs, 0.02, "foh")[0]


def test_doubt_is_told_of_lines_too_and_not_of_fast_logs_nor_of_what_rests():
    t = 0.02 * np.arange(2000)
    (said,) = hold_doubt({"u": source(t, np.sin(t)), "rests": source(t, 0 * t)})
    assert said.startswith("u counts as lines between samples, 20 ms apart")
    assert "some 10 ms, half an interval, shorter" in said
    assert "--hold zoh" in said
    assert hold_doubt({"u": source(t, np.sin(t))}, "foh") == []
    assert hold_doubt({"u": source(t, np.sin(t))}, "zoh")[0].startswith("u counts as held")
    fast = 0.0025 * np.arange(8000)
    assert hold_doubt({"u": source(fast, np.sign(np.sin(fast)))}) == []


@pytest.mark.second
@pytest.mark.parametrize("seed", range(2))
def test_inputs_of_one_message_count_alike_and_their_delays_are_those_of_the_truth(seed):
    """One command steps, one moves smoothly; both are held for 20 ms and act 80 ms later."""
    rng, every, fine = np.random.default_rng(seed), 0.02, 0.0005
    t = np.arange(0, 40, fine)
    own = np.floor(t / every + 1e-6) * every
    commands = [np.sign(np.sin(0.9 * own + 0.01 * own**2)), np.sin(2.1 * own + rng.uniform(0, 6))]
    truth = StateSpace(*([[x]] for x in (-4.0, 5.0, 1.0, 0.0)), delay=[0.08])
    y = [truth.simulate(t, u[:, None], hold="zoh")[:, 0] for u in commands]
    rows = slice(None, None, round(every / fine))
    topic = Topic(name="C", t=t[rows], columns={}, age=0.0)
    names = ("roll", "pitch")
    inputs = {
        name: Source(place=f"C.{name}", topic=topic, values=u[rows])
        for name, u in zip(names, commands, strict=True)
    }
    outputs = {n: source(t[::10], each[::10], n) for n, each in zip("pq", y, strict=True)}
    assert [in_steps(each) for each in inputs.values()] == [True, False]
    assert stepped(inputs) == {*names}
    assert stepped({"pitch": inputs["pitch"]}) == set()
    apart = inputs | {"roll": source(t[rows], commands[0][rows], "other")}
    assert stepped(apart) == {"roll"}  # of another message
    assert "as roll beside it" in hold_told(inputs, outputs, 0.01)[1]
    (record,) = assemble(inputs, outputs, 0.01, "flight")
    tau, found = np.linspace(0.065, 0.095, 61), []
    for k in range(2):
        lags = [replace(truth, delay=np.array([each])) for each in tau]
        left = [m.simulate(record.t, record.u[:, [k]], hold=record.hold)[:, 0] for m in lags]
        errors = [np.sum((each - record.y[:, k])[200:-20] ** 2) for each in left]
        found.append(tau[np.argmin(errors)])
    np.testing.assert_allclose(found, 0.08, atol=0.0006)
