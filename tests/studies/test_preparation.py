"""What a study does to its records, against the same done by hand or undone beforehand."""

import re
import warnings
from dataclasses import replace
from shutil import copyfile

import numpy as np
import pytest
from truths.roll_study import write_study

from casid import DataWarning, Record, read_csv, read_records, read_study, write_csv
from casid.studies.preparation import SecondLogger, tell_doubled, with_inputs

PLACE = "[records.identification]\n"
QUIET = ("noise = true", "noise = false")


def read(folder, *changes):
    """Records of identification by name."""
    study = read_study(write_study(folder, *changes))
    return {record.name: record for record in read_records(study)["identification"]}


@pytest.mark.filterwarnings("ignore:record .sweep.*an input moves")
@pytest.mark.filterwarnings("ignore:.* no straight line:casid.DataWarning")
def test_records_are_cut_and_resampled(tmp_path):
    plain = read(tmp_path, QUIET)["sweep"]
    changes = (PLACE, PLACE + "cut = [2.0, 20.0]\nresample = 0.08\n")
    mended = read(tmp_path, QUIET, changes)["sweep"]
    by_hand = plain.cut(2.0, 20.0).resample(0.08)
    np.testing.assert_allclose(mended.t, by_hand.t)
    np.testing.assert_allclose(mended.totals()["p"], by_hand.totals()["p"], atol=1e-12)
    one = (PLACE, PLACE + "cut = { sweep = [2.0, 20.0] }\n")
    records = read(tmp_path, QUIET, one)
    assert (records["sweep"].t[0], records["3211"].t[0]) == (2.0, 0.0)


@pytest.mark.filterwarnings("ignore:record .sweep.*an input moves")
def test_a_cut_that_ends_beyond_a_record_is_told(tmp_path):
    cut = (PLACE, PLACE + "cut = { sweep = [2.0, 400] }\n")
    told = r"'sweep' lasts from 0 to 29.96 s: its cut ends at 400 s, beyond it; .* write inf"
    with pytest.warns(DataWarning, match=told):
        read(tmp_path, cut)
    read(tmp_path, (PLACE, PLACE + "cut = { sweep = [2.0, inf] }\n"))


@pytest.mark.filterwarnings("ignore:.* no straight line:casid.DataWarning")
def test_a_record_with_a_gap_is_resampled_stretch_by_stretch(tmp_path):
    path = write_study(tmp_path, QUIET, (PLACE, PLACE + "resample = 0.08\n"))
    rows = (tmp_path / "sweep.csv").read_text().splitlines(keepends=True)
    (tmp_path / "sweep.csv").write_text("".join(rows[:301] + rows[351:]))  # 2 s are missing
    sweep = read_records(read_study(path))["identification"][1]
    assert sweep.name == "sweep"
    assert [round(float(sweep.t[k]), 2) for k in sweep.gaps()] == [11.92]
    assert {round(each.dt, 9) for each in sweep.stretches()} == {0.08}


def test_channels_are_moved_in_time(tmp_path):
    plain = read(tmp_path, QUIET)["sweep"]
    moved = read(tmp_path, QUIET, (PLACE, f"[channels.shift]\nphi = -0.08\n{PLACE}"))["sweep"]
    np.testing.assert_allclose(moved.totals()["p"], plain.totals()["p"][: moved.N], atol=1e-12)
    later = plain.totals()["phi"][2 : moved.N + 2]
    np.testing.assert_allclose(moved.totals()["phi"], later, atol=1e-9)


def test_skews_that_kinematics_cannot_tell_are_not_taken_for_none(tmp_path):
    path = write_study(tmp_path, (PLACE, f'[channels]\nshift = "kinematics"\n{PLACE}'))
    rng = np.random.default_rng(1)
    for name in ("3211", "sweep", "random"):
        record = read_csv(tmp_path / f"{name}.csv", inputs=["lat"], outputs=["p", "phi"])
        y = np.where(rng.random(record.y.shape) < 0.35, np.nan, record.y)
        write_csv(tmp_path / f"{name}.csv", replace(record, y=y))
    told = r"cannot judge these records .*p was not checked: 3\d% of p is missing, 3\d% of phi"
    with pytest.raises(ValueError, match=told):
        read_records(read_study(path))


def test_a_search_for_outliers_that_finds_none_says_so(tmp_path):
    with pytest.warns(DataWarning, match="outliers count as missing, but none was found"):
        read(tmp_path, (PLACE, f'[channels]\noutliers = "mask"\n{PLACE}'))


def test_a_time_column_and_an_interval_exclude_each_other(tmp_path):
    path = write_study(tmp_path, (PLACE, f'[channels]\ntime = "t"\ndt = 0.1\n{PLACE}'))
    with pytest.raises(ValueError, match=r"\[channels\]: states time and dt"):
        read_study(path)


def test_an_interval_that_a_files_own_time_contradicts_is_refused(tmp_path):
    told = r"column 't' has a sample every 0.04 s, \[channels\] dt = 0.02 counts other instants"
    with pytest.raises(ValueError, match=told):
        read(tmp_path, (PLACE, f"[channels]\ndt = 0.02\n{PLACE}"))
    plain = read(tmp_path)["3211"]
    own = (PLACE, f"[channels]\ndt = 0.04\n{PLACE}")
    np.testing.assert_allclose(read(tmp_path, own)["3211"].t, plain.t, atol=1e-12)
    for path in tmp_path.glob("*.csv"):  # a column without instants in it is no time
        head, *rows = path.read_text().splitlines()
        path.write_text("\n".join([head, *(re.sub("^[^,]*", "0", row) for row in rows)]) + "\n")
    again = read_records(read_study(tmp_path / "study.toml"))["identification"]
    np.testing.assert_allclose(again[0].t, plain.t, atol=1e-12)


def test_a_trim_that_the_values_still_hold_is_told():
    u, y, names = (
        np.zeros((400, 1)),
        30.0 + np.sin(0.05 * np.arange(400))[:, None],
        (("a",), ("u",)),
    )
    total = Record(0.02 * np.arange(400), u, y, *names, "flown")
    with pytest.warns(DataWarning, match="trim says that u = 31 was subtracted, .* lie about 30"):
        tell_doubled(total, {"u": 31.0, "w": 1.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tell_doubled(replace(total, y=y - 30), {"u": 30.0})  # deviations
        tell_doubled(replace(total, y=y - 30 + 3), {"u": 30.0})  # those from a trim a little off
        tell_doubled(replace(total, y=20 * (y - 30) + 29), {"u": 30.0})  # they do pass zero
        tell_doubled(total, {"w": 30.0})  # of no channel
        tell_doubled(replace(total, y=np.nan * y), {"u": 30.0})


@pytest.mark.second
def test_skews_and_outliers_are_mended_by_a_word(tmp_path):
    path = write_study(tmp_path, (PLACE, f'[channels]\nshift = "kinematics"\n{PLACE}'))
    text = path.read_text().replace("[channels]", '[channels]\noutliers = "mask"', 1)
    path.write_text(text)
    for name in ("3211", "sweep", "random"):
        record = read_csv(tmp_path / f"{name}.csv", inputs=["lat"], outputs=["p", "phi"])
        late = record.shift({"p": 0.06})
        y = late.y.copy()
        y[200, 0] += 0.2
        write_csv(tmp_path / f"{name}.csv", replace(late, y=y))
    with pytest.warns(DataWarning) as told:
        records = read_records(read_study(path))["identification"]
    said = " ".join(str(each.message) for each in told)
    assert "outliers count as missing" in said
    lag = float(said.split("p -")[1].split(" ms")[0]) / 1e3
    assert lag == pytest.approx(0.06, abs=0.005)
    assert np.nanmax(np.abs(np.diff(records[0].y[:, 0]))) < 0.1  # the outlier is gone
    assert np.isnan(records[0].y[:, 0]).sum() == 1  # and stays missing


@pytest.mark.second
def test_skews_that_differ_by_record_are_not_mended_by_one_word(tmp_path):
    path = write_study(tmp_path, (PLACE, f'[channels]\nshift = "kinematics"\n{PLACE}'))
    record = read_csv(tmp_path / "sweep.csv", inputs=["lat"], outputs=["p", "phi"])
    write_csv(tmp_path / "sweep.csv", record.shift({"p": 0.2}))
    with pytest.raises(ValueError, match=r"differ by record: .*sweep"):
        read_records(read_study(path))


def test_a_second_logger_is_joined_on_its_clock(tmp_path):
    path = write_study(tmp_path, QUIET)
    plain = read_records(read_study(path))["identification"][1]
    for name in ("3211", "sweep", "random"):
        record = read_csv(tmp_path / f"{name}.csv", inputs=["lat"], outputs=["p", "phi"])
        write_csv(tmp_path / f"{name}_nav.csv", replace(
            record.select(inputs=(), outputs=["phi"]), t=record.t + 3.0,
        ))  # fmt: skip
    second = '[channels.join]\nfile = "{name}_nav.csv"\nchannels = ["phi"]\nclock = -3.0\n'
    path.write_text(path.read_text().replace("[records.id", f"{second}[records.id", 1))
    joined = read_records(read_study(path))["identification"][1]
    assert joined.outputs == ("p", "phi")
    (tmp_path / "nav").mkdir()
    for file in tmp_path.glob("*_nav.csv"):
        copyfile(file, tmp_path / "nav" / file.name)
    text = path.read_text()
    path.write_text(text.replace("{name}_nav", "nav/{name}_nav"))
    np.testing.assert_array_equal(read_records(read_study(path))["identification"][1].y, joined.y)
    path.write_text(text)
    np.testing.assert_allclose(joined.totals()["phi"], plain.totals()["phi"], atol=1e-9)
    # each file has a time of its own, each with its unit
    for file in [*tmp_path.glob("[3sr]*.csv")]:
        head, *rows = file.read_text().splitlines()
        own = "T_NAV" if "_nav" in file.stem else "T_MS"
        if own == "T_MS":
            cells = [row.split(",", 1) for row in rows]
            rows = [f"{1e3 * float(time):.10g},{rest}" for time, rest in cells]
        file.write_text("\n".join([head.replace("t,", f"{own},", 1), *rows]) + "\n")
    text = path.read_text().replace("clock = -3.0", 'clock = -3.0\ntime = "T_NAV"')
    text = text.replace("[channels.join]", '[channels]\ntime = "T_MS"\n[channels.join]')
    path.write_text(text.replace("[channels.units]", '[channels.units]\nT_MS = "ms"'))
    again = read_records(read_study(path))["identification"][1]
    np.testing.assert_allclose(again.t, joined.t, atol=1e-9)
    np.testing.assert_allclose(again.totals()["phi"], joined.totals()["phi"], atol=1e-9)


def test_a_logger_of_inputs_gives_them_as_they_are_held():
    t = np.arange(0, 2, 0.1)
    y = np.column_stack([np.arange(20.0), np.where(np.arange(20) % 4 == 0, np.arange(20), np.nan)])
    record = Record(t, np.zeros((20, 0)), y, (), ("p", "lat"), hold="zoh")
    made = with_inputs(record, ("lat",))
    assert (made.inputs, made.outputs) == (("lat",), ("p",))
    np.testing.assert_array_equal(made.u[:16, 0], np.repeat([0, 4, 8, 12], 4))
    assert made.t[-1] == t[16]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (f"{PLACE}cut = [3]\n", r"expected \[start, end\] in seconds"),
        (f"{PLACE}cut = {{ zz = [1, 2] }}\n", "cut: unknown key 'zz'"),
        (f"{PLACE}cut = [5, 3]\n", r"expected \[start, end\] in seconds"),
        (f"{PLACE}resample = -1\n", "expected seconds above 0"),
        (f'[channels]\nshift = "auto"\n{PLACE}', 'expected "kinematics"'),
        (f'[channels]\noutliers = "drop"\n{PLACE}', 'expected "keep" or "mask"'),
        (f'[channels.join]\nfile = "nav.csv"\n{PLACE}', "the second file of each record"),
        (f'[channels.join]\nfile = "{{name}}.csv"\nchannels = ["q"]\n{PLACE}', "none of lat"),
        (f'[channels.join]\nfile = "{{name}}.csv"\n{PLACE}', "channels are missing"),
    ],
)
def test_what_is_asked_for_wrongly_is_told(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_study(write_study(tmp_path, (PLACE, change)))


def test_samples_that_nobody_measured_are_told_and_a_senseless_interval_names_its_key(tmp_path):
    with pytest.warns(DataWarning, match=r"measured every 0.04 s: resample = 0.01 adds samples"):
        read(tmp_path, QUIET, (PLACE, PLACE + "resample = 0.01\n"))
    with pytest.raises(ValueError, match=r"^resample = 1000: record "):
        read(tmp_path, QUIET, (PLACE, PLACE + "resample = 1000\n"))


@pytest.mark.parametrize(
    "key", ["past = 5000", "past = 10\nfuture = 5000", "past = 10\norder = 100000"]
)
def test_windows_longer_than_every_record_are_refused_when_records_are_read(tmp_path, key):
    text = write_study(tmp_path, QUIET).read_text()
    head, rest = text.split("[pbsid]\n")
    rest = rest[rest.index("\n[") :] if "\n[" in rest else ""
    (tmp_path / "study.toml").write_text(f"{head}[pbsid]\n{key}\n{rest}")
    with pytest.raises(ValueError, match=rf"\[pbsid\] {key.splitlines()[-1]} needs a window of"):
        read_records(read_study(tmp_path / "study.toml"))


@pytest.mark.parametrize("fresh", [False, True])
def test_samples_that_a_second_logger_repeats_are_told_or_missing_before_they_are_interpolated(
    fresh,
):
    t = 0.02 * np.arange(1000)
    x = np.sin(t) + 0.4 * np.sin(3.1 * t)
    first = Record(t, x[:, None], x[:, None], ["lat"], ["p"], "flight")
    held = np.repeat(x[::5], 5)[:, None]
    other = Record(t + 3.003, np.zeros((1000, 0)), held, [], ["phi"], "nav")
    second = SecondLogger(file="{name}_nav.csv", channels=("phi",), clock=-3.0)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        joined = second.joined(first, other, fresh=fresh)
    said = [str(each.message) for each in told]
    assert ("repeats samples of a slower source in phi" in " ".join(said)) == (not fresh)
    phi = joined.channel("phi")
    known = np.isfinite(phi)
    assert known.mean() == pytest.approx(0.2 if fresh else 1.0, abs=0.01)
    error = np.abs(phi[known] - np.interp(joined.t[known] - 0.003, t, x))
    assert (error.max() < 0.01) == fresh
