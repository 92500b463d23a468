import re
import warnings
from dataclasses import replace
from pathlib import Path

import click.testing
import nptdms
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from truths import bodies
from truths.logs import DAMPING, DELAY, GAIN, STEP, STICKS, WRITERS, flight, ulog

from casid import DataWarning, import_log, kinematic_check, read_records, read_study, run_study
from casid.cli import main
from casid.logs import drafting
from casid.logs.conventions import derived, find_channels
from casid.logs.topics import Log, Topic
from casid.studies.study import read_flights

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def drafts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for name, write in WRITERS.items():
        (folder / name).write_bytes(write())
    return {name: import_log(folder / name, folder / name[-3:]) for name in WRITERS}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.slow
def test_a_log_becomes_a_study_that_is_in_order(drafts, name):
    draft = drafts[name]
    study = read_study(draft.study)
    records = read_records(study)
    assert study.model.inputs == ("roll", "pitch", "yaw")
    assert {len(each) for each in records.values()} == {1}
    assert [each.record.name for each in draft.stretches] == ["flight_1", "flight_2"]
    (record,) = draft.records
    assert record.duration == pytest.approx(40, abs=0.1)
    assert draft.log.path.name == name


@pytest.mark.second
def test_a_draft_is_never_overwritten(drafts, monkeypatch):
    draft = drafts["flight.ulg"]
    draft.study.write_text("mine")
    with pytest.raises(ValueError, match="is there already"):
        import_log(draft.log.path, draft.study.parent)
    assert draft.study.read_text() == "mine"
    (draft.study.parent / "axes.py").write_text("mine, too")
    files = [path for path in draft.study.parent.rglob("*") if path.is_file()]
    before = {path: path.read_bytes() for path in files}
    with monkeypatch.context() as patch:
        patch.setattr(drafting, "TEMPLATE", "{what stops it at the last file}")
        with pytest.raises(KeyError):
            import_log(draft.log.path, draft.study.parent, fresh=True)
    now = [path for path in draft.study.parent.rglob("*") if path.is_file()]
    assert {path: path.read_bytes() for path in now} == before
    import_log(draft.log.path, draft.study.parent, fresh=True)
    assert read_study(draft.study).title == "flight"


@pytest.mark.second
def test_what_is_shaken_on_a_bench_is_doubted_and_what_flies_is_not(tmp_path, drafts):
    shaken = import_log(EXAMPLES / "px4" / "shaken.ulg", tmp_path / "shaken")
    said = " ".join(shaken.doubts)
    assert "actuator_outputs never moves" in said
    assert "controller's inverse" in said
    assert [draft.doubts for draft in drafts.values()] == [()] * len(WRITERS)


@pytest.mark.campaign
def test_attitudes_that_come_late_are_told_and_offered_and_change_no_share(tmp_path, drafts):
    path, late = tmp_path / "late.ulg", 0.06
    path.write_bytes(ulog(angles_late=late))
    draft, sound = import_log(path, tmp_path / "late"), drafts["flight.ulg"]
    assert sound.moves == {}
    assert [*draft.moves] == ["phi", "theta", "psi"]  # the whole topic
    np.testing.assert_allclose([*draft.moves.values()], -late, atol=0.01)
    for found, whole in zip(draft.stretches, sound.stretches, strict=True):
        np.testing.assert_allclose(found.excitation.lower, whole.excitation.lower, atol=0.1)
    text = draft.study.read_text()
    draft.study.write_text(text.replace("# shift = {", "shift = {"))
    records = read_records(read_study(draft.study))["identification"]
    assert kinematic_check(records).shifts == {}
    draft.study.write_text(text)
    raw = read_records(read_study(draft.study))["identification"]
    assert {*kinematic_check(raw).shifts} == {"p", "q"}  # early, as much


@pytest.mark.slow
def test_one_stretch_is_divided_and_none_takes_the_longest_record(tmp_path, monkeypatch):
    path = tmp_path / "short.ulg"
    path.write_bytes(ulog(12.0))
    draft = import_log(path, tmp_path / "one")
    first, second = (each.record for each in draft.stretches)
    assert first.t[-1] <= second.t[0]
    monkeypatch.setattr(drafting, "find_stretches", lambda _: [])
    draft = import_log(path, tmp_path / "none")
    assert sum(each.record.duration for each in draft.stretches) == pytest.approx(12, abs=0.1)


@pytest.mark.slow
def test_a_structure_of_the_users_takes_the_channels_it_names(tmp_path, drafts):
    model = drafts["flight.bin"].study.with_name("axes.py")
    path = tmp_path / "other.tdms"
    path.write_bytes(WRITERS["flight.tdms"](12.0))
    draft = import_log(
        path,
        model=f"{model}:Axes",
        columns={"roll": "sticks.yaw", "pitch": "sticks.pitch", "yaw": "sticks.roll"},
        dt=0.05,
    )
    assert draft.study == tmp_path / "other" / "study.toml"
    assert draft.inputs["yaw"].place == "sticks.roll"
    assert draft.records[0].dt == pytest.approx(0.05)
    assert not draft.study.with_name("axes.py").exists()
    read_study(draft.study)


@pytest.mark.second
@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda: ulog(4.0), "6 s are wanted"),
        (
            lambda: ulog(2.0).replace(b"gyro_rad", b"gyro_mil").replace(b"rollspeed", b"rollspace"),
            "rates",
        ),
        (lambda: ulog(2.0).replace(b"actuator_controls_0", b"actuator_controls_x"), "inputs"),
    ],
)
def test_logs_that_cannot_make_a_study_are_refused_in_words(tmp_path, write, said):
    path = tmp_path / "log.ulg"
    path.write_bytes(write())
    with pytest.raises(ValueError, match=said):
        import_log(path)
    assert not (tmp_path / "log").exists()


@pytest.mark.second
def test_surfaces_are_inputs_and_roll_beside_them_is_an_attitude(tmp_path):
    _, x = flight(20.0)
    named = {"Aileron": "roll", "Rudder": "yaw", "Roll": "phi", "Pitch": "theta"}
    named |= {name: name for name in "pqr"}
    wave = {"wf_increment": STEP, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(tmp_path / "own.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("f", n, x[k], wave) for n, k in named.items()])
    draft = import_log(tmp_path / "own.tdms")
    assert {n: each.place for n, each in draft.inputs.items()} == {
        "aileron": "f.Aileron", "rudder": "f.Rudder",
    }  # fmt: skip
    assert list(draft.outputs) == ["p", "q", "r", "phi", "theta"]
    model = read_study(draft.study).model
    assert (model.inputs, model.outputs) == (("aileron", "rudder"), ("p", "r", "phi"))


@pytest.mark.slow
def test_an_airspeed_that_the_user_names_is_checked_and_drives_nothing(tmp_path):
    """Its slow samples set no interval either, and knots are knots: 40 m/s, by definition."""
    t, x = flight(20.0)
    wave, rare = ({"wf_increment": k * STEP, "wf_start_offset": 0.0} for k in (1, 10))
    columns = [nptdms.ChannelObject("log", name, x[name], wave) for name in (*STICKS, *"pqr")]
    knots = 40.0 / (1852 / 3600) + np.sin(t[::10])
    columns += [nptdms.ChannelObject("air", "TAS", knots, rare | {"unit_string": "knots"})]
    with nptdms.TdmsWriter(tmp_path / "own.tdms") as writer:
        writer.write_segment(columns)
    alone = import_log(tmp_path / "own.tdms", tmp_path / "alone")
    draft = import_log(tmp_path / "own.tdms", tmp_path / "air", columns={"V": "air.TAS"})
    assert list(draft.inputs) == list(alone.inputs) == [*STICKS]
    assert draft.records[0].dt == alone.records[0].dt
    assert draft.assumed == alone.assumed
    study = read_study(draft.study)
    assert "V" in study.channels.check
    assert np.nanmean(draft.records[0].channel("V")) == pytest.approx(40.0, abs=0.1)


@pytest.mark.slow
def test_units_that_a_log_does_not_state_are_told_and_unknown_ones_refused(tmp_path):
    path = tmp_path / "log.tdms"
    said = WRITERS["flight.tdms"](12.0)
    path.write_bytes(said)
    usual = import_log(path)
    assert usual.assumed[:3] == tuple(
        f"unit of {name} not stated: taken as it is" for name in ("roll", "pitch", "yaw")
    )
    assert (usual.outputs["p"].unit, usual.inputs["roll"].unit) == ("deg/s", "")
    path.write_bytes(said.replace(b"deg/s", b"gra/s"))
    with pytest.raises(ValueError, match=r"gyros\.p, of p, is in 'gra/s'.*--unit p=UNIT"):
        import_log(path, fresh=True)
    stated = import_log(path, fresh=True, units=dict.fromkeys("pqr", "deg/s"))
    np.testing.assert_allclose(stated.outputs["p"].values, usual.outputs["p"].values, rtol=1e-12)
    path.write_bytes(said.replace(b"deg/s", b"     "))
    draft = import_log(path, fresh=True)
    assert "unit of p not stated: taken as rad/s" in draft.assumed
    assert "# unit of p not stated: taken as rad/s\n" in draft.study.read_text()
    told = import_log(path, fresh=True, units={"p": "deg/s"})
    np.testing.assert_allclose(told.outputs["p"].values, usual.outputs["p"].values, rtol=1e-12)
    with pytest.raises(ValueError, match="no channel"):
        import_log(path, fresh=True, units={"P": "deg/s"})


@pytest.mark.slow
def test_the_drafted_study_finds_the_aircraft(tmp_path):
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog())
    outcome = run_study(read_study(import_log(path).study))
    rows = {row.name: row for row in outcome.identification.output_error.parameters}
    for names, wanted in (
        (("Lp", "Mq", "Nr"), DAMPING),
        (("Lroll", "Mpitch", "Nyaw"), GAIN),
        (("tau_roll", "tau_pitch", "tau_yaw"), [DELAY] * 3),
    ):
        found = np.array([[rows[n].value, rows[n].std_error] for n in names])
        assert (np.abs(found[:, 0] - wanted) < 4 * found[:, 1] + 0.02 * np.abs(wanted)).all()
    assert {each.word for each in outcome.verdicts} == {"good"}


@pytest.mark.slow
def test_whatever_stops_an_import_names_the_log(tmp_path, monkeypatch):
    """Here records too short to be moved by what kinematics asks for."""
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog())
    monkeypatch.setattr(
        drafting, "aligned", lambda *_: (dict.fromkeys(("phi", "theta", "psi"), 100.0), ())
    )
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: .*record"):
        import_log(path, tmp_path / "draft")


@pytest.mark.second
def test_a_log_with_numbers_that_no_sensor_gives_is_read_without_them(tmp_path):
    """Warnings of overflow are errors here."""
    _, x = flight()
    x["p"][[500, 2000, 5000]] = [1e308, -1e200, np.inf]
    wave = {"wf_increment": STEP, "wf_start_offset": 0.0}
    columns = [nptdms.ChannelObject("log", name, x[name], wave) for name in (*STICKS, "p", "q")]
    path = tmp_path / "flight.tdms"
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(columns)
    draft = import_log(path, tmp_path / "draft", units={"p": "rad/s", "q": "rad/s"})
    rates = np.concatenate([each.channel("p") for each in draft.records])
    assert np.nanmax(np.abs(rates)) < 10.0


@pytest.mark.second
def test_wild_samples_are_named_and_change_no_share(tmp_path):
    wave = {"wf_increment": STEP, "wf_start_offset": 0.0}
    drafts = []
    for number, wild in enumerate((0, 1)):
        _, x = flight()
        moving = np.argmax(np.abs(x["p"]))
        x["p"][moving + np.arange(3 * wild)] = -99.0
        path = tmp_path / f"flight{number}.tdms"
        columns = [nptdms.ChannelObject("log", name, x[name], wave) for name in (*STICKS, "p", "q")]
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment(columns)
        units = {"p": "rad/s", "q": "rad/s"}
        drafts.append(import_log(path, tmp_path / f"draft{number}", units=units))
    sound, wild = drafts
    said = [each for each in wild.doubts if "far off all others" in each]
    assert len(said) == 1
    assert re.search(r"^\d+ samples? far off all others \(flight1_\d: p\): .*mask", said[0])
    assert set(wild.doubts) - set(said) == set(sound.doubts)
    for own, other in zip(wild.stretches, sound.stretches, strict=True):
        np.testing.assert_allclose(own.excitation.lower, other.excitation.lower, atol=0.1)


SI = dict.fromkeys(bodies.RATES, "rad/s") | dict.fromkeys(bodies.ATTITUDES, "rad")
SI |= dict.fromkeys(bodies.FORCES, "m/s^2") | dict.fromkeys(bodies.SPEEDS, "m/s")


def recorded(path, record):
    """A TDMS log of a flight, with sticks that step for most of it."""
    rng = np.random.default_rng(3)
    steps = rng.choice([-0.1, 0.0, 0.1], size=(200, 2))[(record.t / 0.6).astype(int)]
    steps *= ((record.t > 4) & (record.t < 0.9 * record.t[-1]))[:, None]
    columns = dict(zip(("lat", "lon"), steps.T, strict=True)) | {"t": record.t}
    columns |= {name: record.channel(name) for name in record.outputs}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject(
                    "log", n, x, {"wf_increment": record.dt, "unit_string": SI.get(n, "")}
                )
                for n, x in columns.items()
            ]
        )


@pytest.mark.parametrize(
    ("late", "upside_down", "begin"),
    [
        ({}, None, None),
        pytest.param({}, "theta", "theta has the opposite sign", marks=pytest.mark.campaign),
        pytest.param(
            dict.fromkeys(bodies.SPEEDS, 0.06), None, "u v w are 0.0", marks=pytest.mark.campaign
        ),
        pytest.param(
            dict.fromkeys(bodies.ATTITUDES, 0.06),
            None,
            "phi theta are 0.0",
            marks=pytest.mark.campaign,
        ),
    ],
    ids=["good", "theta", "velocities", "attitudes"],
)
@pytest.mark.parametrize("detrend", [pytest.param("first", marks=pytest.mark.campaign), "mean"])
@pytest.mark.campaign
def test_a_drafted_study_judges_as_the_records_of_the_log_are_judged(
    tmp_path, late, upside_down, begin, detrend
):
    records = bodies.flown(700, late=late, count=1, duration=60.0)
    if upside_down:
        records = bodies.reversed_in(records, upside_down)
    recorded(tmp_path / "log.tdms", *records)
    draft = import_log(tmp_path / "log.tdms", tmp_path / "log")
    text = draft.study.read_text()
    assert 'check = ["r", "ax", "ay", "az", "u", "v", "w"]' in text
    draft.study.write_text(text.replace('detrend = "first"', f'detrend = "{detrend}"'))
    study = read_study(draft.study)
    flown = read_flights(study)[0]["identification"]
    assert all(each.trim for each in flown)
    told = [kinematic_check(each).remarks for each in (draft.records, flown)]
    for remarks in told:
        assert len(remarks) == (begin is not None)
        assert all(said.startswith(begin) for said in remarks)
    assert {*kinematic_check(flown).shifts} == {*draft.moves} == {*late}
    if late:  # the shift that the draft offers mends the study
        np.testing.assert_allclose([*kinematic_check(flown).shifts.values()], -0.06, atol=0.01)
        draft.study.write_text(draft.study.read_text().replace("# shift = {", "shift = {"))
        mended = read_flights(read_study(draft.study))[0]["identification"]
        assert kinematic_check(mended).remarks == ()
    inspected = click.testing.CliRunner().invoke(main, ["inspect", str(draft.study)])
    assert ("opposite sign" in inspected.output) == (upside_down is not None)
    assert inspected.exit_code == 0


LOGGED = {
    "vehicle_angular_velocity": dict(
        zip(("xyz[0]", "xyz[1]", "xyz[2]"), bodies.RATES, strict=True)
    ),
    "vehicle_acceleration": dict(zip(("xyz[0]", "xyz[1]", "xyz[2]"), bodies.FORCES, strict=True)),
    "vehicle_local_position": dict(zip(("vx", "vy", "vz"), bodies.SPEEDS, strict=True)),
}


def autopilot(seed, late):
    """What an autopilot logs of a rigid body at 12 m/s, its attitudes so much late [s]; the truth.

    Velocities are logged north, east, down; sticks step at random beside it.
    """
    rng = np.random.default_rng([81, seed])
    signals = bodies.path(rng, 12.0, 40.0, np.ones(6))
    t = 0.02 * np.arange(2000)
    x, behind = signals(t), signals(t - late)
    turn, logged = (
        Rotation.from_euler("ZYX", np.transpose([y[n] for n in ("psi", "theta", "phi")]))
        for y in (x, behind)
    )
    seen = x | dict(
        zip(bodies.SPEEDS, turn.apply(np.transpose([x[n] for n in bodies.SPEEDS])).T, strict=True)
    )
    noise = bodies.NOISE | dict.fromkeys(bodies.SPEEDS, 0.05)
    seen = {n: y + noise[n] * rng.standard_normal(len(t)) for n, y in seen.items()}
    steps = rng.choice([-0.1, 0.0, 0.1], size=(200, 2))[(t / 0.6).astype(int)]
    steps *= ((t > 4) & (t < 36))[:, None]
    quaternion = [logged.as_quat()[:, k] for k in (3, 0, 1, 2)]
    columns = {n: {c: seen[y] for c, y in own.items()} for n, own in LOGGED.items()}
    columns["vehicle_attitude"] = {f"q[{k}]": y for k, y in enumerate(quaternion)}
    columns["actuator_controls_0"] = {f"control[{k}]": steps[:, k] for k in range(2)}
    topics = {n: Topic(name=n, t=t, columns=own) for n, own in columns.items()}
    return Log(path=Path("flight.ulg"), kind="PX4 ULog", topics=topics), t, x


def kept(text, shift):
    """A study's text with another shift."""
    text = re.sub(r"\n# (shift =|Kinematics finds).*", "", text)
    return text.replace("[channels]\n", f"[channels]\nshift = {shift}\n")


def in_line(log, monkeypatch, *moves):
    """Velocities and what is told where kinematics asks for these moves one after another."""
    asked = iter(moves)
    monkeypatch.setattr(drafting, "_moves", lambda _: next(asked))
    inputs, outputs = find_channels(derived(log))
    found, (record,), _, last, told = drafting._in_line(log, inputs, outputs, 0.02, None)
    assert np.nanmax(np.abs(found["v"].values - record.channel("v"))) < 0.3
    return found["v"].values, last, told


@pytest.mark.second
def test_velocities_are_turned_anew_only_where_attitudes_are_late_then_too(monkeypatch):
    log, _, true = autopilot(0, 0.05)
    late = dict.fromkeys(bodies.ANGLES, -0.05)
    anew, last, (told,) = in_line(log, monkeypatch, late, late)
    assert last == late
    assert told == (
        "u, v, w are turned from north, east, down by attitudes logged 50 ms later, as kinematics "
        "finds these late"
    )
    raw, last, told = in_line(log, monkeypatch, late, {})
    assert (last, told) == (late, [])
    inside = slice(20, -20)
    slopes = [np.polyfit(true["r"][inside], (v - true["v"])[inside], 1)[0] for v in (raw, anew)]
    # 12 m/s times 50 ms; noise of 0.05 m/s in 2000 samples.
    assert slopes == pytest.approx([0.6, 0.0], abs=0.05)


@pytest.mark.second
def test_part_of_a_message_moves_only_where_a_logger_stamps_channels_one_by_one(monkeypatch):
    log, _, _ = autopilot(0, 0.0)
    part = {"p": 0.03}
    assert in_line(log, monkeypatch, part)[1] == {}
    assert in_line(replace(log, kind="TDMS file"), monkeypatch, part)[1] == part


@pytest.mark.campaign
@pytest.mark.parametrize(("seed", "late"), [(0, 0.05), (1, 0.05), (2, 0.05), (0, 0.0), (1, 0.0)])
def test_velocities_are_turned_by_attitudes_that_are_late_no_more(
    tmp_path, monkeypatch, seed, late
):
    log, t, true = autopilot(seed, late)
    monkeypatch.setattr(drafting, "read_log", lambda _: log)
    draft = import_log("flight.ulg", tmp_path)
    wanted = dict.fromkeys(bodies.ANGLES, -late) if late else {}
    assert {*draft.moves} == {*wanted}
    np.testing.assert_allclose([*draft.moves.values()], [*wanted.values()], atol=0.01)
    (record,) = draft.records
    inside = slice(20, -20)
    off = record.channel("v") - np.interp(record.t, t, true["v"])
    r = np.interp(record.t, t, true["r"])
    # As logged it was off by 0.6 m for every rad/s. Noise of 0.05 m/s in 2000 samples of r.
    slope = np.polyfit(r[inside], off[inside], 1)[0]
    assert slope == pytest.approx(0.0, abs=12.0 * 0.005 + 4 * 0.05 / (r.std() * len(r) ** 0.5))
    assert ("turned from north, east, down" in " ".join(draft.assumed)) == bool(late)
    text = draft.study.read_text()
    assert ("inputs stay, so that their delays to phi, theta, psi" in text) == bool(late)
    said = kinematic_check([each.record for each in draft.stretches]).remarks
    assert not any("accelerometers" in each for each in said)
    # The study's own rule on the same records.
    offered = re.search(r"# shift = (.*)", text)
    found = []
    for shift in (offered[1] if offered else "{}", '"kinematics"'):
        draft.study.write_text(kept(text, shift))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)
            found.append(read_flights(read_study(draft.study))[0]["identification"])
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one.t, other.t, atol=2e-4)
        for name in ("phi", "p", "v"):
            np.testing.assert_allclose(one.channel(name), other.channel(name), atol=2e-3)


@pytest.mark.parametrize("dt", [0.0, -1.0, float("inf")])
def test_an_interval_that_is_none_is_refused(drafts, dt):
    with pytest.raises(ValueError, match="expected a sampling interval above 0 s"):
        import_log(drafts["flight.ulg"].log.path, "anywhere", dt=dt)
