"""What `inspect_records` says of records, each fact against records in which it is put."""

from dataclasses import replace

import numpy as np
import pytest
from truths.flights import NOISE, flight

from casid import Record
from casid.commands.inspection import inspect_records
from models.six_dof import SixDof

STEP = 0.02


def swept(omega=2.0, n=1500, **changes):
    """A record with one sine on `lat`, and `p` following it; quiet for a second."""
    t = STEP * np.arange(n)
    lat = np.where(t > 1, 0.1 * np.sin(omega * (t - 1)), 0.0)
    rng = np.random.default_rng(0)
    y = np.column_stack([lat, 0.2 * lat]) + 1e-4 * rng.standard_normal((n, 2))
    u = np.column_stack([lat, np.where(t > 1, 0.1 * np.sin(1.6 * omega * (t - 1)), 0.0)])
    return replace(Record(t, u, y, ("lat", "ped"), ("p", "r"), "sine"), **changes)


def facts(found, name):
    return next(each for each in found.records[0].channels if each.name == name)


def test_good_records_get_no_advice():
    found = inspect_records([swept()])
    assert found.advice == ()
    assert found.usable is None
    record = found.records[0]
    assert (record.samples, record.equidistant, record.gaps) == (1500, True, ())
    assert abs(record.interval - STEP) < 1e-12
    assert abs(record.quiet - 1.0) < 3 * STEP


def test_power_lies_where_the_sine_is():
    lat = facts(inspect_records([swept(omega=3.0)]), "lat")
    # One line of the spectrum, 0.2 rad/s apart, and the window's width on either side.
    assert abs(lat.band[1] - 3.0) < 0.25
    assert lat.band[0] <= lat.band[1] <= lat.band[2]


def test_noise_is_measured_beside_the_signal():
    p = facts(inspect_records([swept()]), "p")
    # 1500 samples: the standard deviation of a standard deviation is 2 to 3 %.
    assert abs(p.noise - 1e-4) < 1.5e-5


def test_inputs_that_move_alike_are_named():
    record = swept()
    u = np.column_stack([record.u[:, 0], 0.5 * record.u[:, 0] + 0.01 * record.u[:, 1]])
    found = inspect_records([replace(record, u=u)])
    assert found.correlation[0, 1] > 0.99
    assert any("ped and lat move together" in said for said in found.advice)


def test_bands_are_those_between_gaps():
    record = swept()
    (whole,) = inspect_records([record]).records
    late = replace(record, t=record.t + 3600.0 * (np.arange(record.N) >= record.N - 20))
    (parted,) = inspect_records([late]).records
    for one, other in zip(whole.channels, parted.channels, strict=True):
        np.testing.assert_allclose(other.band, one.band, rtol=0.1)


@pytest.mark.parametrize(("every", "omega"), [(4, 3.0), (10, 3.0), (25, 2.0)])
def test_a_channel_ten_times_slower_than_its_record_has_its_band_and_moves(every, omega):
    record = swept(omega=omega)
    y = record.y.copy()
    y[np.arange(record.N) % every != 0, 1] = np.nan
    found = inspect_records([replace(record, y=y)])
    # The sine is one line of the spectrum, which all channels have, at whatever rate.
    np.testing.assert_allclose(facts(found, "r").band, facts(found, "p").band, atol=0.25)
    assert not any("never moves" in said for said in found.advice)


def test_what_rests_in_the_longest_stretch_and_moves_in_another_moves():
    record = swept()
    late = replace(
        record, t=record.t + 100.0 * (record.t > 20), y=record.y * (record.t > 20)[:, None]
    )
    found = inspect_records([late])
    assert np.isnan(facts(found, "p").band).all()
    assert not any("never moves" in said for said in found.advice)


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_stamps_that_jitter_are_no_gaps_and_a_lost_second_among_them_is_one(share):
    record = swept()
    rng = np.random.default_rng(4)
    jitter = share * record.dt * rng.uniform(-1, 1, record.N)
    (facts,) = inspect_records([replace(record, t=record.t + jitter)]).records
    assert facts.gaps == ()
    late = replace(record, t=record.t + jitter + (record.t > 10))
    ((at, length),) = inspect_records([late]).records[0].gaps
    assert (at, length) == pytest.approx((10.0, 1.0), abs=0.04)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda r: replace(r, y=np.clip(r.y, -0.05, 0.05)), ("p stays at its extreme value",)),
        (lambda r: replace(r, u=np.clip(11 * r.u, -1, 1)), ("lat stays at its extreme stop",)),
        (lambda r: replace(r, u=100 * r.u), ("'lat' reaches 10", "is it in %?")),
        (lambda r: replace(r, u=r.u * [1, 0]), ("ped never moves: fly it",)),
        (lambda r: replace(r, y=r.y * [0, 1]), ("p never moves: look at its sensor",)),
        (lambda r: r.with_noise({"r": 1.0}, np.random.default_rng(1)), ("r is mostly noise",)),
        (lambda r: r.between(5, 20), ("an input moves within 0.5 s of the start",)),
        (lambda r: replace(r, y=np.where(r.t[:, None] % 1 < 0.1, np.nan, r.y)),
         ("p lacks 10.",)),
        (lambda r: replace(r, t=r.t + (r.t > 10) * 0.5), ("1 gap in time", "0.52 s")),
        (lambda r: r.take(slice(None, None, 40)), ("record faster",)),
        (lambda r: replace(r, t=1000 * r.t), ("time column 't' advances 20 s", "is it in ms?")),
        (lambda r: replace(r, y=600 * r.y), ("'p' reaches", "is it in deg/s?")),
    ],
)  # fmt: skip
def test_what_is_in_the_way_is_said_with_the_culprit(damage, words):
    said = " | ".join(inspect_records([damage(swept())]).advice)
    for word in words:
        assert word in said


def test_instants_of_records_since_1970_are_told_apart():
    record = swept(t=1780358400.0 + STEP * np.arange(1500) + 5.0 * (np.arange(1500) >= 600))
    y = record.y.copy()
    y[300, 0] += 200
    said = " | ".join(inspect_records(replace(record, y=y)).advice)
    assert "the longest of 5.02 s at 1780358411.98 s" in said
    assert "p has 1 outlier, the first at 1780358406 s" in said
    with pytest.raises(ValueError, match=r"between 1780358300 s .* from 1780358400 s to 17803584"):
        record.cut(1780358300.0, 1780358390.0)


def test_a_slower_channel_misses_nothing_but_what_its_own_rate_promises():
    record = swept()
    slow = record.y.copy()
    slow[np.arange(record.N) % 4 != 0, 1] = np.nan
    found = inspect_records(replace(record, y=slow))
    assert facts(found, "r").missing == 0
    assert not any("lacks" in said for said in found.advice)
    slow[500:800, 1] = np.nan
    found = inspect_records(replace(record, y=slow))
    assert facts(found, "r").missing == pytest.approx(0.2)
    assert "sine: r lacks 20.0% of its samples" in found.advice


def test_a_run_of_outliers_is_listed_as_one_and_makes_no_good_channel_noise():
    record = swept().with_noise({"p": 0.001, "r": 0.001}, np.random.default_rng(2))
    y = record.y.copy()
    y[300:340, 0] = 20 * np.ptp(y[:, 0]) * np.random.default_rng(3).uniform(0.5, 1, 40)
    found = inspect_records(replace(record, y=y))
    assert facts(found, "p").noise == pytest.approx(0.001, rel=0.2)
    assert facts(found, "r").outliers == ()
    (said,) = [each for each in found.advice if "p has 40 outliers" in each]
    assert f"in a row 40 from {record.t[300]:.4g} to {record.t[339]:.4g} s" in said
    assert not any("mostly noise" in each or "lacks" in each for each in found.advice)


def test_an_outlier_is_listed_and_makes_no_good_channel_noise():
    record = swept().with_noise({"p": 0.001, "r": 0.001}, np.random.default_rng(2))
    y = record.y.copy()
    y[300, 0] += 200 * np.ptp(y[:, 0])
    found = inspect_records(replace(record, y=y))
    assert facts(found, "p").outliers == (pytest.approx(record.t[300]),)
    assert facts(found, "p").noise == pytest.approx(0.001, rel=0.2)
    assert any(f"p has 1 outlier, the first at {record.t[300]:.4g} s" in x for x in found.advice)
    assert not any("mostly noise" in said for said in found.advice)


def test_what_the_user_stated_is_believed():
    record = replace(swept(), u=100 * swept().u)
    assert any("'lat' reaches" in said for said in inspect_records([record, record]).advice)
    said = inspect_records([record], stated=["lat", "ped"]).advice
    assert not any("reaches" in each for each in said)


def test_a_channel_without_samples_is_no_reason_to_fail():
    record = swept()
    found = inspect_records(
        [replace(record, y=np.column_stack([np.full(record.N, np.nan), record.y[:, 1]]))]
    )
    assert any("p never moves" in said for said in found.advice)


@pytest.mark.slow
def test_kinematics_is_part_of_the_advice():
    record = flight(0, {"p": (0.1, 0.0, 0.0)}, NOISE, ("p", "q", "r", "phi", "theta"))
    found = inspect_records([record])
    # The scale has a standard error of 0.1 %.
    assert any(said.startswith(("p is 1.09", "p is 1.1")) for said in found.advice)


def test_a_model_is_judged_by_what_was_flown():
    t = STEP * np.arange(800)
    rng = np.random.default_rng(0)
    u = np.zeros((800, 4))
    u[100:300, 1] = np.repeat(rng.uniform(-0.1, 0.1, 10), 20)
    y = SixDof().system().simulate(t, u)
    found = inspect_records(
        [Record(t, u, y, SixDof.inputs, SixDof.outputs, "lateral only")], model=SixDof()
    )
    assert found.usable is False
    said = " | ".join(found.advice)
    assert "cannot tell all parameters of SixDof apart" in said
    assert "no output depends on Xcol" in said


@pytest.mark.slow
def test_a_hundred_thousand_samples_need_no_matrix_of_their_squares():
    found = inspect_records([swept(n=100_000)])
    assert found.records[0].samples == 100_000


def test_noise_of_a_measured_input_is_told():
    t = np.arange(0, 30, 0.02)
    steps = 0.1 * np.sign(np.sin(0.8 * t)) * (t > 2)
    y = np.cumsum(steps)[:, None] * 0.02 + 0.001 * np.random.default_rng(1).standard_normal(
        (1500, 1)
    )
    clean = Record(t, steps[:, None], y, ("lat",), ("p",), "steps")
    noisy = replace(clean, u=clean.u + 0.01 * np.random.default_rng(2).standard_normal((1500, 1)))
    assert not any("noise of" in line for line in inspect_records(clean).advice)
    (said,) = (line for line in inspect_records(noisy).advice if "the noise of lat is" in line)
    share = float(said.split("% of its movement")[0].split()[-1])
    assert share == pytest.approx(10, abs=2)  # its steps look a little like noise


def test_noise_of_an_input_that_rests_in_one_record_is_seen_beside_what_it_moves_in_others():
    noise = 0.001 * np.random.default_rng(3).standard_normal((1500, 2))
    moved = swept()
    moved = replace(moved, u=moved.u + noise)
    resting = replace(moved, u=moved.u * [1.0, 0.0] + noise, name="ped rests")
    said = inspect_records([moved, resting]).advice
    assert not any("noise of" in line for line in said)


def test_nothing_is_blamed_for_rows_that_no_instrument_measured():
    record = swept()
    y = record.y.copy()
    y[[300, 700]] = -999.0
    found = inspect_records([replace(record, y=y)])
    assert len(found.advice) == 2
    assert all("has 2 outliers" in line for line in found.advice)
    assert facts(found, "p").outliers == (record.t[300], record.t[700])
    assert facts(found, "p").deviation == pytest.approx(record.y[:, 0].std(), rel=0.01)


@pytest.mark.parametrize("step", [0.02, 0.01])
def test_a_channel_counted_in_coarse_steps_is_neither_wrong_nor_saturated(step):
    record = swept()
    y = record.y.copy()
    y[:, 0] = np.round(y[:, 0] / step) * step
    assert not any("p " in line for line in inspect_records([replace(record, y=y)]).advice)
    y[500, 0] += 0.1
    (said,) = (line for line in inspect_records([replace(record, y=y)]).advice if "p has" in line)
    assert "p has 1 outlier," in said


def test_a_stick_that_darts_is_no_reason_to_record_faster():
    u = swept().u.copy()
    u[[400, 700, 1000], 0] = 5.0
    found = inspect_records([swept(u=u)])
    assert sum("lat jumps away" in each for each in found.advice) == 3
    assert not any("record faster" in each for each in found.advice)


def test_one_column_read_twice_is_named():
    y = swept().y
    found = inspect_records([swept(y=np.column_stack([y[:, 0], y[:, 0]]))])
    assert "r and p are the same samples: one column read twice?" in found.advice


def looped(seed):
    """A roll axis whose noisy sensors are fed back while a sweep is flown."""
    rng, n = np.random.default_rng(seed), 3000
    t = STEP * np.arange(n)
    sweep = np.where(t > 1, 0.1 * np.sin(0.5 * t + 0.05 * t**2), 0.0)
    p, phi, u, y = 0.0, 0.0, np.zeros((n, 1)), np.zeros((n, 2))
    for k in range(n):
        y[k] = [p, phi] + rng.standard_normal(2) * [0.01, 0.003]
        u[k] = sweep[k] - 0.4 * y[k, 0] - 0.5 * y[k, 1]
        for _ in range(4):
            p += STEP / 4 * (-2 * p + 10 * u[k, 0])
            phi += STEP / 4 * p
    return Record(t, u, y, ("lat",), ("p", "phi"), f"loop {seed}", hold="zoh")


@pytest.mark.slow
def test_shares_from_outside_are_those_of_records_in_line():
    # A rate that comes late looks like feedback.
    records = [looped(seed) for seed in (1, 2)]
    sound = inspect_records(records)
    late = inspect_records([record.shift({"p": 0.04}) for record in records])
    assert any("p" in each and "0.04" in each for each in late.advice)
    shares = [np.nanmedian(found.excitation.lower) for found in (sound, late)]
    assert shares[1] == pytest.approx(shares[0], abs=0.1)


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.parametrize("samples", [3, 5, 8])
def test_a_scrap_of_a_record_beside_late_ones_is_no_reason_to_fail(samples):
    late = [looped(seed).shift({"p": 0.08}) for seed in (1, 2)]
    scrap = replace(late[0].take(slice(500, 500 + samples)), name="scrap")
    assert inspect_records([*late, scrap]).kinematics.shifts
