"""Kinematic consistency: known instrument errors are found, and none where there are none."""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy
from truths import bodies
from truths.flights import ERRORS, FORCES, NOISE, RATES, STATES, flight, scores, truth
from truths.hovering import hover
from truths.places import EXAMPLES
from truths.roll_study import write_study

from casid import DataWarning, outliers, read_csv
from casid.consistency import kinematics
from casid.consistency.clock_skews import Apart
from casid.consistency.kinematics import _clocks_differ, kinematic_check
from casid.exchange.formats import read_table, write_table
from casid.record import Record
from casid.studies.runner import run_study
from casid.studies.studyfile import read_study

INPUTS = ("col", "lat", "lon", "ped")
OUTPUTS = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")
ATTITUDES = (*RATES, "phi", "theta")
WHOLE = (*RATES, *FORCES, *STATES)
FLOWN = dict(zip(OUTPUTS, (0.05, 0.05, 0.1, *[0.003] * 5), strict=True))


def times(record, name, factor):
    return replace(
        record, y=np.where(np.array(record.outputs) == name, factor * record.y, record.y)
    )


def uh60(which="3211_*.csv", outputs=OUTPUTS):
    files = sorted((EXAMPLES / "uh60/data").glob(which))
    return [read_csv(file, inputs=INPUTS, outputs=outputs) for file in files]


@pytest.fixture(scope="module")
def noisy():
    rng = np.random.default_rng(7)
    return [record.with_noise(FLOWN, rng) for record in uh60()]


def test_no_place_of_accelerometers_is_told_beside_attitudes_and_rates_of_different_clocks():
    late, fine = (0.03, 0.001), (0.001, 0.001)
    assert _clocks_differ(Apart(late={"phi": late}))
    assert _clocks_differ(Apart(left={"p": (-0.03, 0.001), "ay": fine}))
    assert not _clocks_differ(Apart(left={"p": fine, "ay": late}))
    assert not _clocks_differ(Apart(late={"u": late}))


@pytest.mark.second
@pytest.mark.parametrize("late", [0.0, 0.06])
def test_a_place_is_told_of_one_clock_alone(late, monkeypatch):
    monkeypatch.setattr(kinematics, "misplaced", lambda *_: ("accelerometers elsewhere",))
    check = kinematic_check(bodies.flown(3, "slow", dict.fromkeys(bodies.ATTITUDES, late)))
    assert ("accelerometers elsewhere" in check.headline()) == (late == 0.0)


# ---- truth known -------------------------------------------------------------------------------


@pytest.mark.second
@pytest.mark.parametrize("outputs", [WHOLE, ATTITUDES, (*ATTITUDES, "psi")], ids=len)
def test_scale_bias_and_skew_are_found_within_three_sigma(outputs):
    check = kinematic_check([flight(0, ERRORS, NOISE, outputs)])
    assert {each.channel for each in check.channels} == {*RATES, *FORCES} & set(outputs)
    assert np.abs(scores(check)).max() < 3


@pytest.mark.second
def test_without_noise_the_errors_are_found_almost_exactly():
    check = kinematic_check([flight(0, ERRORS)])
    for each in check.channels:
        scale, bias, skew = ERRORS[each.channel]
        # The skew of r enters the products with attitudes by interpolation: 1e-4 of a scale.
        np.testing.assert_allclose([each.scale, each.skew], [scale, skew], atol=3e-4)
        assert abs(each.bias - bias) < 1e-3


@pytest.mark.second
def test_each_error_is_put_into_words():
    check = kinematic_check([flight(0, {"p": (0.08, 0.0, 0.06)}, NOISE)])
    scale, skew = check.remarks
    assert scale.startswith("p is 1.08")
    assert "times what phi implies" in scale
    assert "s late against phi" in skew
    assert not check.consistent


def euler(rates, attitudes, h):
    """Attitudes (N, 3) that rates(t) fly, by Runge and Kutta of SciPy."""

    def moves(t, x):
        (p, q, r), (phi, theta, _) = rates(t), x
        turn = (q * np.sin(phi) + r * np.cos(phi)) / np.cos(theta)
        return [p + np.sin(theta) * turn, q * np.cos(phi) - r * np.sin(phi), turn]

    t = h * np.arange(1500)
    found = scipy.integrate.solve_ivp(moves, (0, t[-1]), attitudes, t_eval=t, rtol=1e-9, atol=1e-9)
    return t, found.y.T


@pytest.mark.second
@pytest.mark.parametrize("what", ["turn north", "rolls"])
def test_angles_that_are_kept_within_a_turn_follow_like_others(what):
    def rates(t):
        wave = 0.1 * np.sin(2 * t)
        return (2.0 * (what == "rolls") + wave, 0.1 * np.sin(1.3 * t), 0.2 + 0.1 * np.cos(1.7 * t))

    t, angles = euler(rates, [0.0, 0.0, 3.0], 0.02)
    y = np.column_stack([np.array([rates(each) for each in t]), angles])
    y += 0.003 * np.random.default_rng(3).standard_normal(y.shape)
    whole = Record(t, np.zeros((len(t), 0)), y, (), (*ATTITUDES, "psi"), "whole")
    kept = np.column_stack([y[:, :3], (y[:, 3:] + np.pi) % (2 * np.pi) - np.pi])
    with pytest.warns(DataWarning, match="psi jumps by whole turns"):
        within = replace(whole, y=kept, name="within")
    assert kinematic_check(within).remarks == ()
    assert not outliers(within).any()
    turns = (within.y - whole.y) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[:1]) + 0 * turns, atol=1e-12)


@pytest.fixture(scope="module")
def rolling():
    """Two short flights, seen by rates and attitudes."""
    return [flight(k, None, NOISE, ATTITUDES, f"{k}").take(slice(900)) for k in (0, 1)]


def biased(records, biases):
    """Records whose p has these biases."""
    p = np.array(ATTITUDES) == "p"
    return [replace(r, y=r.y + b * p) for r, b in zip(records, biases, strict=True)]


@pytest.mark.second
def test_biases_of_each_record_are_named_and_are_neither_scale_nor_movement_left(rolling):
    biases = (0.03, 0.0)
    check = kinematic_check(biased(rolling, biases))
    (said,) = check.remarks
    assert re.fullmatch(r"p has a bias of up to 0\.0\d+ ± \S+ rad/s against phi in 0", said)
    p = check.channels[0]
    assert [name for name, _, _ in p.biases] == ["0", "1"]
    for (_, found, error), true in zip(p.biases, biases, strict=True):
        assert abs(found - true) < 4 * error < 0.005
    assert p.bias_error > 0.01  # of the mean: records differ by more than noise


@pytest.mark.second
@pytest.mark.parametrize("channel", ["p", "phi"])
def test_a_sensor_frozen_in_one_record_is_told(rolling, channel):
    frozen = [times(rolling[0], channel, 0.0), *rolling[1:]]
    said = " ".join(kinematic_check(frozen).remarks)
    assert "phi does not follow from the other channels in 0:" in said
    assert len(said) < 300


@pytest.mark.second
def test_one_bias_of_all_records_is_named_once(rolling):
    (said,) = kinematic_check(biased(rolling, (0.03, 0.03))).remarks
    assert re.fullmatch(r"p has a bias of 0\.0\d+ ± \S+ rad/s against phi", said)


LATE = dict.fromkeys((*RATES, *FORCES), (0.0, 0.0, 0.06))


@pytest.mark.second
def test_channels_of_a_logger_of_which_nothing_is_told_move_with_the_others():
    late = flight(0, LATE, NOISE, (*ATTITUDES, *FORCES))  # forces have no velocities to stand by
    check = kinematic_check([late])
    assert {*check.shifts} <= {*RATES}
    moves, (why,) = check.shifts_of(late.outputs)
    assert {*moves} == {*RATES, *FORCES}
    np.testing.assert_allclose(list(moves.values()), -0.06, atol=0.005)
    assert why.startswith("ax, ay, az")
    assert "show no other skew" in why
    alone = check.shifts_of(("p", "q", "r"))
    assert {*alone[0]} == {*RATES}
    assert check.shifts_of(FORCES) == ({}, ())  # a logger of their own


@pytest.mark.second
def test_a_logger_whose_channels_differ_in_skew_moves_one_by_one():
    mixed = flight(0, {"p": (0.0, 0.0, 0.06)}, NOISE, (*ATTITUDES, *FORCES))
    moves, (why,) = kinematic_check([mixed]).shifts_of(mixed.outputs)
    assert moves == {"p": pytest.approx(-0.06, abs=0.005)}
    assert why.startswith(
        "ax, ay, az, q, r not shifted: skews of its logger's channels differ (p +"
    )


@pytest.mark.second
@pytest.mark.parametrize("outputs", [WHOLE, ATTITUDES], ids=len)
@pytest.mark.parametrize("seed", [1, 2])
def test_good_instruments_give_no_alarm(seed, outputs):
    check = kinematic_check([flight(seed, None, NOISE, outputs)])
    assert check.remarks == ()


@pytest.mark.campaign
@pytest.mark.parametrize("outputs", [WHOLE, ATTITUDES, (*ATTITUDES, "psi")], ids=len)
def test_standard_errors_are_those_of_thirty_flights(outputs):
    z = np.array([scores(kinematic_check([flight(seed, ERRORS, NOISE, outputs)]))
                  for seed in range(30)])  # fmt: skip
    # 90 or 180 normal values a column: their rms lies within 0.75 and 1.25 with p > 0.999 if the
    # errors are right, and none exceeds 4.
    rms = np.sqrt(np.mean(z**2, axis=(0, 1)))
    assert (rms > 0.7).all()
    assert (rms < 1.25).all()
    assert np.abs(z).max() < 4


@pytest.mark.second
def test_alpha_beta_and_speed_serve_as_velocities():
    record = flight(0, {"az": (0.1, 0.0, 0.0)}, NOISE)
    u, v, w = (record.channel(name) for name in ("u", "v", "w"))
    V = np.sqrt(u**2 + v**2 + w**2)
    air = np.column_stack([V, np.arctan2(w, u), np.arcsin(v / V)])
    rates = record.select(outputs=[name for name in record.outputs if name not in {"u", "v", "w"}])
    seen = replace(rates, y=np.hstack([rates.y, air]),
                   outputs=(*rates.outputs, "V", "alpha", "beta"))  # fmt: skip
    az = next(each for each in kinematic_check([seen]).channels if each.channel == "az")
    assert abs(az.scale - 0.1) < 3 * az.scale_error


@pytest.mark.second
def test_missing_samples_and_irregular_instants_do_not_matter():
    record = flight(0, ERRORS, NOISE, ATTITUDES)
    rng = np.random.default_rng(3)
    kept = np.sort(rng.choice(record.N, round(0.98 * record.N), replace=False))
    y = np.where(rng.random(record.y.shape) < 0.01, np.nan, record.y)
    thinned = replace(record, t=record.t[kept], u=record.u[kept], y=y[kept])
    found = {each.channel: each for each in kinematic_check([thinned]).channels}
    assert abs(found["p"].scale - 0.08) < 3 * found["p"].scale_error + 0.005
    assert abs(found["p"].skew - 0.06) < 3 * found["p"].skew_error + 0.002


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:.*follow the one before within 5%")
def test_gaps_split_a_record_and_stop_nothing():
    record = flight(0, {"p": (0.1, 0.0, 0.0)}, NOISE, ATTITUDES)
    away = ((record.t > 10) & (record.t < 14)) | ((record.t > 25) & (record.t < 25.5))
    kept = replace(record, t=record.t[~away], u=record.u[~away], y=record.y[~away])
    p = kinematic_check([kept]).channels[0]
    assert abs(p.scale - 0.1) < 3 * p.scale_error
    rng = np.random.default_rng(0)
    random = replace(record, t=np.sort(rng.uniform(0, 40, record.N)))  # instants of no sense at all
    found = kinematic_check([random])  # cut into pieces too short to tell, or found to disagree
    assert np.isnan(found.channels[0].scale) or not found.consistent


# ---- example records ---------------------------------------------------------------------------


@pytest.mark.second
@pytest.mark.parametrize("aircraft", ["uh60", "ah1s"])
def test_the_simulated_helicopters_obey_kinematics(aircraft):
    files = sorted((EXAMPLES / aircraft / "data").glob("3211_???.csv"))
    outputs = (*OUTPUTS, "u", "v", "w")
    check = kinematic_check([read_csv(file, inputs=INPUTS, outputs=outputs) for file in files])
    assert check.remarks == ()
    assert len(check.channels) == 6
    for each in check.channels:  # noise-free records: integration steps of the simulations remain
        assert abs(each.scale) < 0.01
        assert abs(each.skew) < 0.006


@pytest.mark.second
def test_records_with_trim_removed_are_checked_with_it(noisy):
    whole, rest = kinematic_check(noisy), kinematic_check([r.detrend("first") for r in noisy])
    for a, b in zip(whole.channels, rest.channels, strict=True):
        np.testing.assert_allclose([a.scale, a.skew], [b.scale, b.skew], rtol=1e-6)


def test_noise_of_good_instruments_gives_no_alarm(noisy):
    check = kinematic_check(noisy)
    assert check.remarks == ()
    assert check.notes[0].startswith("specific forces were checked against gravity in trim only")


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 0.1, 0.3], ids=["exact", "good", "rough"])
def test_noise_in_rates_and_forces_is_no_error_of_theirs(speed):
    """It multiplies what is fitted, and pulls gains and skews where little else moves."""
    std = FLOWN | dict.fromkeys(("u", "v", "w"), speed)
    records = uh60(outputs=(*OUTPUTS, "u", "v", "w"))
    for seed in (0, 3):
        rng = np.random.default_rng(1000 + seed)
        assert kinematic_check([record.with_noise(std, rng) for record in records]).remarks == ()


MISTAKES = {
    "p upside down": ("p", -1.0, "p is -", "opposite sign"),
    "q in degrees": ("q", 180 / np.pi, "q is 57", "in degrees"),
    "phi in degrees": ("phi", 180 / np.pi, "phi reaches", "degrees"),
    "az up": ("az", -1.0, "az is 9.7", "opposite sign"),
    "az in g": ("az", 1 / 9.80665, "az is -0.99", "in g"),
    "theta upside down": ("theta", -1.0, "theta has ", "opposite sign"),
    "p ten per cent too large": ("p", 1.1, "p is 1.1", "scale factors"),
}


@pytest.mark.second
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_a_mistake_in_signs_or_units_is_named(mistake, noisy):
    name, factor, begin, word = MISTAKES[mistake]
    remarks = kinematic_check([times(record, name, factor) for record in noisy]).remarks
    # The scale of a noisy rate has a standard error of half a per cent.
    assert any(said.startswith(begin[:-1]) and word in said for said in remarks), remarks


@pytest.mark.slow
@pytest.mark.parametrize(("name", "feet"), [("ax", True), ("r", False)])
def test_only_what_has_a_length_is_said_to_be_in_feet(name, feet):
    record = times(flight(1, None, NOISE, WHOLE), name, 1 / 0.3048)
    said = [each for each in kinematic_check([record]).remarks if each.startswith(f"{name} is 3.")]
    assert len(said) == 1
    assert ("feet" in said[0]) == feet


@pytest.mark.slow
def test_an_equation_that_lacks_a_channel_says_less():
    # The yaw rate turns bank too, by tan(theta) of it: some per cent.
    error = {"p": (0.08, 0.0, 0.0)}
    told, untold = (
        kinematic_check([flight(k, error, NOISE, outputs) for k in range(2)]).remarks
        for outputs in (ATTITUDES, ("p", "phi"))
    )
    assert [said[:7] for said in told] == ["p is 1."]
    assert untold == ()
    (note,) = kinematic_check(flight(0, error, NOISE, ("p", "phi"))).notes
    assert (
        note == "a scale of p is reported only if it is off by 10% or more: there is no q, r, theta"
    )


@pytest.mark.campaign
def test_a_velocity_that_two_mistakes_spoil_follows_from_nothing():
    check = kinematic_check([times(times(flight(0, None, NOISE), "w", -1.0), "u", 0.3)])
    assert any(said.startswith("w does not follow") for said in check.remarks)


# ---- what cannot be checked --------------------------------------------------------------------


@pytest.mark.second
def test_perturbations_are_recognised_by_the_gravity_they_lack(noisy):
    bare = [replace(record.detrend("first"), trim={}) for record in noisy]
    check = kinematic_check(bare)
    assert any("the records are perturbations" in note for note in check.notes)
    assert check.consistent
    whole = kinematic_check(bare, trim=noisy[0].detrend("first").trim)
    assert not any("perturbations" in note for note in whole.notes)


def turning(outputs, scale=1.06):
    """A hover about zero pitch whose gyros all read so many times what turns it."""
    record = hover(2, 0.01, duration=30.0).select(outputs=outputs)
    for name in RATES:
        record = times(record, name, scale)
    return record


GYROS = (*ATTITUDES, "psi")


@pytest.mark.second
def test_gravity_in_az_tells_that_attitudes_about_zero_are_total_values():
    check = kinematic_check(turning((*GYROS, "az")))
    for each, (said,) in zip(check.channels, [c.remarks for c in check.channels], strict=True):
        assert re.match(rf"{each.channel} is 1\.0\d+ ± \S+ times what {each.against[0]} im", said)
        assert abs(each.scale - 0.06) < 4 * each.scale_error < 0.012
    assert not any("10%" in note for note in check.notes)
    assert kinematic_check(turning((*GYROS, "az"), 1.0)).remarks == ()


@pytest.mark.second
def test_attitudes_about_zero_that_may_be_perturbations_are_checked_roughly_and_that_is_said():
    check = kinematic_check(turning(GYROS))
    assert check.remarks == ()
    (note,) = check.notes
    assert note.startswith(
        "a scale of p, q, r is reported only if it is off by 10% or more: theta is about zero"
    )
    assert "p is 1.1" in " ".join(kinematic_check(turning(GYROS, 1.15)).remarks)
    stated = kinematic_check(turning(GYROS), trim={"theta": 0.0})
    assert "p is 1.06" in " ".join(stated.remarks)
    assert stated.notes == ()


@pytest.mark.second
def test_attitudes_beside_an_az_without_gravity_are_checked_roughly():
    record = turning((*GYROS, "az"))
    bare = replace(record, y=record.y + 9.80665 * (np.array(record.outputs) == "az"))
    check = kinematic_check(bare)
    assert check.remarks == ()
    first, *_, last = check.notes
    assert "attitudes only roughly" in first
    assert (
        last == "a scale of p, q, r is reported only if it is off by 10% or more: az has no "
        "gravity in it"
    )


def test_a_channel_that_hardly_moves_is_not_judged(noisy):
    check = kinematic_check([record for record in noisy if "lon" in record.name])
    r = next(each for each in check.channels if each.channel == "r")
    assert not r.determined
    assert any("say nothing about r" in note for note in check.notes)


def test_records_without_a_pair_of_channels_leave_a_note_and_no_result():
    check = kinematic_check([flight(0, outputs=("p", "q", "ax"))])
    assert check.channels == ()
    assert "p was not checked: there is no phi" in check.notes
    assert kinematic_check([flight(0, outputs=("ax",))]).consistent


def test_a_reference_of_which_most_is_missing_is_no_absent_one():
    record = flight(0, outputs=("p", "phi"))
    holed = record.mask(np.array([False, True]) & (record.t[:, None] % 1 > 0.3))
    (note,) = kinematic_check(holed).notes
    assert re.fullmatch(r"p was not checked: (69|70) % of phi is missing".replace(" %", "%"), note)


@pytest.mark.parametrize("spoilt", ["nothing", "a row lost", "uneven stamps"])
@pytest.mark.parametrize("every", [2, 4])
def test_a_channel_sampled_less_often_than_the_others_is_judged_all_the_same(every, spoilt):
    shifted = flight(0, outputs=("p", "phi")).shift({"phi": 0.08})
    own = np.arange(shifted.N) % every == 0  # a slower logger's
    late = shifted.mask(np.array([False, True]) & ~own[:, None])
    if spoilt == "a row lost":
        late = late.take(np.arange(late.N) != 301)
    elif spoilt == "uneven stamps":
        odd = np.random.default_rng(0).uniform(-0.01, 0.01, late.N)
        late = replace(late, t=late.t + odd * late.dt)
    check = kinematic_check(late)
    (p,) = (each for each in check.channels if each.channel == "p")
    assert p.skew == pytest.approx(-0.08, abs=4 * p.skew_error + 0.002)
    assert p.skew_error < 0.01
    assert not [note for note in check.notes if "phi" in note]


def calm(seed, every, slower):
    """A flight in pitch alone; ``slower`` outputs are sampled every so many samples."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 20.001, 0.01)
    theta = 0.06 + 0.05 * np.sin(0.8 * t) * np.minimum(1, t / 3)
    y = np.outer(theta, [0, 0, 0, 0, 1.0])
    y[:, 1] = np.gradient(theta, t)
    y += rng.normal(0, np.deg2rad([0.15, 0.15, 0.15, 0.1, 0.1]), y.shape)
    names = (*RATES, "phi", "theta")
    rare = np.isin(names, slower) & (np.arange(len(t)) % every != 0)[:, None]
    return Record(t, np.zeros((len(t), 1)), np.where(rare, np.nan, y), ["el"], names, "calm")


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("every", [2, 4])
@pytest.mark.parametrize("slower", [("phi", "theta"), RATES], ids="-".join)
def test_slower_sampling_neither_alarms_nor_blinds(every, slower):
    record = calm(every, every, slower)
    assert kinematic_check(record).remarks == ()
    (said,) = kinematic_check(times(record, "q", -1.0)).remarks
    assert said.endswith("opposite sign")
    assert "q is 1.2" in "".join(kinematic_check(times(record, "q", 1.25)).remarks)


@pytest.mark.second
@pytest.mark.parametrize("channel", ["p", "phi"])
def test_outliers_are_told_and_hide_no_skew(channel):
    record = flight(0, {"p": (0.0, 0.0, 0.06)}, NOISE, ATTITUDES)
    rng = np.random.default_rng(4)
    y, i = record.y.copy(), record.outputs.index(channel)
    k = np.sort(rng.integers(100, record.N - 100, 5))
    y[k, i] += 20 * NOISE[channel] * rng.choice([-1, 1], 5)
    y[rng.random(y.shape) < 0.01] = np.nan
    check = kinematic_check(replace(record, y=y))
    (p,) = (each for each in check.channels if each.channel == "p")
    assert p.skew == pytest.approx(0.06, abs=0.005)
    assert any("p is 0.06" in said and "late" in said for said in check.remarks)
    said = f"{channel} has 5 outliers, left out here; the first at {record.t[k[0]]:.4g} s"
    assert said in check.notes


@pytest.mark.second
@pytest.mark.parametrize("outputs", [bodies.WHOLE, ATTITUDES], ids=len)
def test_attitudes_in_whole_degrees_are_called_that_and_contradict_nothing(outputs):
    step, records = np.deg2rad(1.0), bodies.flown(300, outputs=outputs, single=True)
    for name in ("phi", "theta"):
        records = bodies.changed(records, name, lambda x: step * np.round(x / step))
    check = kinematic_check(records)
    assert check.remarks == ()
    assert check.channels == ()
    said = "p was not checked: phi is counted in steps of 0.0175 rad, too coarse for its movement"
    assert check.notes[0] == said


# ---- in a study --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_study_says_in_log_result_and_report_what_does_not_agree(tmp_path, caplog):
    study = write_study(tmp_path)
    for file in ("3211.csv", "sweep.csv", "random.csv"):
        table = read_table(tmp_path / file)
        write_table(tmp_path / file, table | {"phi": 1.25 * table["phi"]})
    with caplog.at_level("WARNING", logger="casid"):
        outcome = run_study(read_study(study))
    remark = outcome.identification.kinematics.remarks[0]
    assert remark.startswith("p is 0.8")  # 1/1.25, with a standard error of half a per cent
    assert "do not agree with kinematics: p is 0.8" in caplog.text
    report = outcome.report.read_text(encoding="utf-8")
    assert "Kinematic consistency of the data" in report
    assert "Kinematics: p is 0.8" in report


@pytest.mark.second
def test_a_channel_in_another_unit_has_a_scale_and_an_error_that_many_times_larger():
    record = flight(0, ERRORS, NOISE, ATTITUDES)
    plain, double = (
        {each.channel: each for each in kinematic_check([data]).channels}
        for data in (record, times(record, "p", 2.0))
    )
    assert 1 + double["p"].scale == pytest.approx(2 * (1 + plain["p"].scale), rel=1e-3)
    assert double["p"].scale_error == pytest.approx(2 * plain["p"].scale_error, rel=1e-2)
    assert double["p"].bias_error == pytest.approx(2 * plain["p"].bias_error, rel=1e-2)
    assert double["p"].skew_error == pytest.approx(plain["p"].skew_error, rel=1e-2)


@pytest.mark.second
def test_accelerometers_away_from_the_centre_of_gravity_are_remarked():
    place = np.array([1.5, 0.0, -0.5])
    signals, t = truth(2)
    h = 1e-4
    w = np.array([signals(t)[name] for name in RATES]).T
    slope = np.array([(signals(t + h)[n] - signals(t - h)[n]) / (2 * h) for n in RATES]).T
    record = flight(2)
    more = np.cross(slope, place) + np.cross(w, np.cross(w, place))
    y = record.y + more @ np.array([[float(n == o) for o in record.outputs] for n in FORCES])
    moved = replace(record, y=y).with_noise(NOISE, np.random.default_rng(4))
    check = kinematic_check(moved)
    assert len(check.remarks) == 1
    assert "accelerometers" in check.remarks[0]
    errors = (np.array(check.place) - place) / check.place_error
    assert np.abs(errors).max() < 3.0
    assert max(check.place_error) < 0.2


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.parametrize("channel", ["p", "q"])
def test_a_run_of_outliers_is_told_and_leaves_the_check_as_it_is(channel):
    record = flight(1, None, NOISE)
    y, i = record.y.copy(), record.outputs.index(channel)
    y[700:760, i] += 8 * y[:, i].std()
    check = kinematic_check(replace(record, y=y))
    assert check.remarks == ()
    said = f"{channel} has 60 outliers, left out here; the first at 14 s"
    assert f"{said}; in a row 60 from 14 to 15.18 s" in check.notes


@pytest.mark.slow
def test_skew_is_found_to_five_milliseconds_among_outliers_and_losses():
    rng = np.random.default_rng(5)
    spoiled = []
    for name in ("sweep_lat", "sweep_lon"):
        file = EXAMPLES / "uh60" / "data" / f"{name}.csv"
        record = read_csv(file, inputs=INPUTS, outputs=OUTPUTS).with_noise(FLOWN, rng)
        record = record.shift({"p": 0.06})
        y = record.y.copy()
        for i, channel in enumerate(OUTPUTS):
            k = rng.choice(record.N, 5, replace=False)
            y[k, i] += 20 * FLOWN[channel] * rng.choice([-1, 1], 5)
        y[rng.random(y.shape) < 0.01] = np.nan
        spoiled.append(replace(record, y=y))
    check = kinematic_check(spoiled)
    assert set(check.shifts) == {"p"}
    assert check.shifts["p"] == pytest.approx(-0.06, abs=0.005)
    mended = kinematic_check([record.shift(check.shifts) for record in spoiled])
    assert not any("late" in remark or "early" in remark for remark in mended.remarks)


def noisy_sweeps(seed, late=0.0):
    """Sweeps of an aircraft at 41 m/s, attitudes and velocities beside; r so much late."""
    rng, noise = np.random.default_rng(seed), FLOWN | dict.fromkeys("uvw", 0.1)
    names = (*OUTPUTS, "u", "v", "w")
    for record in uh60("sweep_*.csv", names):
        drawn = rng.standard_normal((len(names), record.N)).T * [noise[name] for name in names]
        yield replace(record, y=record.y + drawn).shift({"r": late})


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8, 9])
def test_sweeps_whose_clocks_are_right_accuse_no_accelerometer_that_hardly_moves(seed):
    # What noise bends of the likelihood of ay's skew was carried on far beyond where it holds.
    assert kinematic_check([*noisy_sweeps(seed)]).remarks == ()


@pytest.mark.slow
def test_a_late_gyro_is_found_in_sweeps():
    check = kinematic_check([*noisy_sweeps(8, 0.06)])
    assert set(check.shifts) == {"r"}
    assert check.shifts["r"] == pytest.approx(-0.06, abs=0.005)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("bank", [0.3, 0.5])
def test_no_gyro_is_blamed_for_a_pitch_rate_that_was_not_recorded(bank):
    # Coordinated turns at constant θ: ψ' = g tan φ / V, θ' = q cos φ - r sin φ = 0.
    rng, dt, theta = np.random.default_rng(2), 0.02, 0.05
    t = dt * np.arange(4000)
    late = np.maximum(t - 3, 0)
    phi = bank * (0.6 * np.sin(0.35 * late) + 0.4 * np.sin(1.1 * late))
    rolling = bank * (0.21 * np.cos(0.35 * late) + 0.44 * np.cos(1.1 * late)) * (t > 3)
    turning = 9.80665 * np.tan(phi) / 35
    p = rolling - turning * np.sin(theta)
    q = turning * np.sin(phi) * np.cos(theta)
    r = turning * np.cos(phi) * np.cos(theta)
    y = np.column_stack([p, q, r, phi, theta + 0 * t]) + 0.003 * rng.standard_normal((len(t), 5))
    names = ("p", "q", "r", "phi", "theta")
    whole = Record(t, rng.standard_normal((len(t), 1)), y, ("lat",), names)
    assert kinematic_check(whole).remarks == ()
    found = kinematic_check(whole.select(outputs=["p", "r", "phi"]), trim={"theta0": theta})
    assert found.remarks == ()
    assert [each.channel for each in found.channels] == ["p"]
    assert "r was not checked: there is no q, there is no theta" in found.notes


@pytest.mark.second
@pytest.mark.parametrize("scale", [1.0, 1.3])
def test_a_roll_gyro_is_judged_where_pitch_moves_unrecorded_and_yaw_goes_with_roll(scale):
    def flown(seed):
        rng = np.random.default_rng([4, seed])
        phase, size = rng.uniform(0, 2 * np.pi, 9), np.deg2rad(rng.uniform(10, 20))

        def rates(t):
            swing = np.sin(np.outer(np.ravel(t), [0.5, 1.1, 1.9]) + phase[:3])
            other = np.sin(np.outer(np.ravel(t), [0.7, 1.3, 2.3]) + phase[3:6])
            p = swing @ [0.1, 0.1, 0.1]
            r = 0.8 * p + 0.2 * other @ [0.1, 0.1, 0.1]
            q = 0.4 * size * np.cos(0.4 * np.ravel(t) + phase[6])
            return np.squeeze(np.column_stack([p, q, r]))

        t, angles = euler(rates, [0.0, size * np.sin(phase[6]), 0.0], 0.02)
        y = np.column_stack([scale * rates(t)[:, 0], rates(t)[:, 2], angles[:, 0]])
        y += 0.003 * rng.standard_normal(y.shape)
        return Record(t, np.zeros((len(t), 0)), y, (), ("p", "r", "phi"), f"{seed}")

    for seed in range(3):
        check = kinematic_check(flown(seed))
        (p,) = check.channels
        assert abs(p.scale - (scale - 1)) < 0.1  # what matters: of q sin φ tan θ nothing is known
        said = [remark.split(":")[0] for remark in check.remarks]
        assert len(said) == (scale != 1.0)
        assert all(re.match(r"p is 1\.\d+ ± 0\.0\d+ times what phi implies", each) for each in said)
