"""The command `design` on a small study."""

import hashlib
import json
import re
from dataclasses import replace

import click.testing
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from truths.roll_study import Truth, write_study

from casid import Fit, NonlinearModel, Record, Scalar, output_error, parameter
from casid.cli import main
from casid.commands.design import PICTURES, _condition, _doubts, _write
from casid.design.injection import OWN
from casid.report.verdicts import Verdict
from casid.studies.runner import run_study
from casid.studies.study import read_records
from casid.studies.studyfile import read_study
from casid.studies.written import Written, digests, keep_written, origin


def run(*arguments):
    return click.testing.CliRunner().invoke(main, ["design", *map(str, arguments)])


TABLE = """
[design]
duration = 12
sticks = { lat = 0.02 }
[design.settings]
method = "steps"
iterations = 10
draws = 4
"""


@pytest.mark.slow
def test_the_studys_table_says_what_is_asked_for_and_options_come_first(tmp_path):
    study = write_study(tmp_path)
    study.write_text(study.read_text() + TABLE)
    scripts = ["--ardupilot", "lat=1:500", "--px4", "lat=y:1000"]
    result = run(study, "--duration", "10", *scripts, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "steps on lat, 10 s: standard errors" in result.output
    card = (tmp_path / "out/design/card.csv").read_text().splitlines()
    largest = max(abs(float(row.split(",")[1])) for row in card[1:])
    assert 0.01 < largest <= 0.02 + 1e-9
    other = np.loadtxt(tmp_path / "out/design/3-2-1-1.csv", delimiter=",", skiprows=1)
    assert other.shape == (len(card) - 1, 2)
    assert (
        "local CHANNELS = {1} -- RC inputs: lat" in (tmp_path / "out/design/card.lua").read_text()
    )
    script = (tmp_path / "out/design/inject.py").read_text()
    assert 'AXES = {"y": ("lat", 1000.0)}' in script
    assert hashlib.sha256((tmp_path / "out/design/card.csv").read_bytes()).hexdigest() in script
    run(study, "--duration", "11", "--px4", "lat=y:900", "-o", tmp_path / "out")
    assert not (tmp_path / "out/design/card.lua").exists()  # it would fly the card of before
    assert 'lat", 900.0' in (tmp_path / "out/design/inject.py").read_text()


class Drawn:
    """A design with a number on everything; its standard errors cannot be drawn, if so said."""

    def __init__(self, number, ending=None):
        self.number, self.ending = number, ending

    def to_csv(self, sequence="card"):
        return f"t,lat\n0,{self.number}\n{sequence}\n"

    def plot(self, *, errors):
        if errors and self.ending is not None:
            raise self.ending
        axes = Figure((1 + self.number, 1)).subplots()
        axes.axis("off")
        return axes


def sizes(folder):
    """Widths of the pictures, in pixels."""
    return {name: imread(folder / name).shape[1] for name in PICTURES}


@pytest.mark.parametrize("ending", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_design_that_could_not_be_written_leaves_the_one_of_before(tmp_path, ending):
    script = f"-- {OWN}"
    _write(tmp_path, Drawn(1), {"design.md": "one", "card.lua": script})
    (tmp_path / "inject.py").write_text("the user's", encoding="utf-8")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(type(ending)):
        _write(tmp_path, Drawn(2, ending), {"design.md": "two"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    first = sizes(tmp_path)
    _write(tmp_path, Drawn(2), {"design.md": "two"})
    for name, ways in (("card.csv", ()), ("3-2-1-1.csv", ("3-2-1-1",))):
        assert (tmp_path / name).read_text(encoding="utf-8") == Drawn(2).to_csv(*ways)
    assert all(sizes(tmp_path)[name] > width for name, width in first.items())
    assert not (tmp_path / "card.lua").exists()
    assert (tmp_path / "inject.py").read_text(encoding="utf-8") == "the user's"


def test_a_key_that_nobody_reads_is_refused_when_the_study_is_read(tmp_path):
    study = write_study(tmp_path)
    study.write_text(study.read_text() + "\n[design]\nlength = 12\n")
    with pytest.raises(ValueError, match=r"\[design\]: unknown key 'length'"):
        read_study(study)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("duration = inf", "duration = inf s: expected a time above 0"),
        ("sticks = { lta = 0.1 }", "limits name 'lta'; did you mean 'lat'?"),
        ("responses = { lat = 0.1 }", "limits name 'lat'"),
        ("responses = { p = 0.0 }", "the limit of 'p' is 0.0"),
        ("feedback = { lat = { q = 0.1 } }", "feedback names 'q'"),
        ("trim = { v = 20.0 }", "Roll is linear, about its own trim: leave trim out"),
        ('settings.fixed = ["NOPE"]', "'NOPE'"),
        ("settings.bounds = { NOPE = [0.0, 1.0] }", "'NOPE'"),
        ('settings.matter = ["Lpp"]', "no free parameter is called 'Lpp'; did you mean 'Lp'?"),
        ("settings.dt = -1.0", "dt = -1 s: expected a time above 0"),
        ("settings.step = 0.0", "step = 0 s: expected a time above 0"),
        ("settings.draws = 1000000", "0 or more, 1000 at most"),
    ],
)
def test_a_design_that_cannot_be_is_refused_when_the_study_is_read(tmp_path, said, words):
    study = write_study(tmp_path)
    study.write_text(f"{study.read_text()}\n[design]\n{said}\n")
    with pytest.raises(ValueError, match=rf"\[design\].*{re.escape(words)}"):
        read_study(study)


def test_what_the_settings_hold_bound_and_sample_comes_before_what_the_study_does(
    tmp_path, monkeypatch
):
    made = []
    monkeypatch.setattr(
        "casid.commands.design.design_inputs", lambda *_, settings, **__: made.append(settings)
    )
    own = "[model]\nfixed = ['Yv']\nbounds = { Lp = [-5, -1], Lv = [-1, 0] }\n"
    study = write_study(tmp_path, ("[model]\n", own))
    plain = study.read_text()
    run(study, "-o", tmp_path / "out")
    said = 'fixed = ["Lv"]\nbounds = { Lp = [-2.9, -1.0] }\ndt = 0.1\n'
    study.write_text(f"{plain}\n[design.settings]\n{said}")
    run(study, "-o", tmp_path / "out")
    study.write_text(f"{plain}\n[design.settings]\ndt = 0.0335\n")
    result = run(study, "-o", tmp_path / "out", "--ardupilot", "lat=1:500")
    assert "33.5 ms apart" in " ".join(result.stderr.split())
    as_study, as_said = made  # none of what no autopilot flies
    assert as_study.fixed == ("Yv",)
    assert as_study.bounds == {"Lp": (-5.0, -1.0), "Lv": (-1.0, 0.0)}
    assert as_study.dt == pytest.approx(0.04)  # that of the records
    assert as_said.fixed == ("Lv",)
    assert as_said.bounds == {"Lp": (-2.9, -1.0), "Lv": (-1.0, 0.0)}
    assert as_said.dt == 0.1


@pytest.mark.second
def test_a_study_without_a_fit_is_designed_from_its_guess(tmp_path):
    study = write_study(tmp_path)
    study.write_text(study.read_text() + TABLE.replace("sticks", "# sticks"))
    result = run(study, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "steps on lat, 12 s: standard errors 0." in result.output
    card = (tmp_path / "out/design/card.csv").read_text().splitlines()
    assert card[0] == "t,lat"
    largest = max(abs(float(row.split(",")[1])) for row in card[1:])
    assert 0.03 < largest <= 0.05 + 1e-9  # the 3-2-1-1 of the study has 5 %
    for picture in ("design.png", "errors.png"):
        assert (tmp_path / "out/design" / picture).stat().st_size > 10_000
    page = (tmp_path / "out/design/design.md").read_text()
    assert "## Standard errors" in page
    assert "was chosen by" not in page  # nothing was asked for but steps
    study.write_text(study.read_text().replace('method = "steps"', 'criterion = "MV"'))
    assert run(study, "-o", tmp_path / "out", "--duration", "8").exit_code == 0
    page = (tmp_path / "out/design/design.md").read_text()
    kind = page.split(maxsplit=2)[1]
    assert f"\n\nOf steps and multisine, {kind} was chosen by the criterion MV, " in page


@pytest.mark.second
def test_the_weakest_parameters_are_those_that_a_flight_can_tell(tmp_path):
    study = write_study(tmp_path)
    study.write_text(study.read_text() + TABLE)
    model = tmp_path / "roll.py"
    twin = '    more: Scalar = parameter(default=0.0, lower=-1.0, upper=1.0, unit="1/s")\n'
    text = model.read_text().replace("    g: float", f"{twin}    g: float")
    model.write_text(text.replace("self.Lp, 0]", "self.Lp + self.more, 0]"))
    result = run(study, "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    said, table = result.output.split("Weakest parameters")
    assert "without Lp, more, which no input identifies" in " ".join(said.split())
    names = re.findall(r"(Yv|Lv|Lp|Llat|more)\s+-?[0-9]", table)
    assert sorted(names) == ["Llat", "Lv", "Yv"]  # neither of the two that are one


def test_an_example_of_feedback_is_spelled_as_the_option(tmp_path):
    study = write_study(tmp_path)
    study.write_text(study.read_text() + TABLE)
    model = tmp_path / "roll.py"
    model.write_text(model.read_text().replace("self.Lp, 0]", "-self.Lp, 0]"))  # it runs away
    result = run(study, "-o", tmp_path / "out")
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert "give the feedback that is flown, such as --feedback lat:p=0.1" in said
    assert "feedback={" not in said


def test_without_a_fit_the_study_has_to_say_the_noise_in_its_own_words(tmp_path):
    study = write_study(tmp_path)
    text = study.read_text().replace("noise = true\n", "")
    study.write_text(text[: (k := text.index("[noise]"))] + text[text.index("\n\n", k) :])
    result = run(study, "-o", tmp_path / "out")
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert "give the study the tables [noise], with seed = 0, and [noise.std], with p = " in said
    assert "noise={" not in said


def test_a_fit_of_the_structure_as_it_was_is_to_be_made_again(tmp_path):
    study = write_study(tmp_path)
    t = 0.05 * np.arange(200)
    u = 0.05 * np.sin(t + 0.1 * t**2)[:, None]
    y = Truth().system().simulate(t, u)
    noisy = Record(t, u, y, ("lat",), ("p", "phi")).with_noise(
        {"p": 0.002, "phi": 0.002}, np.random.default_rng(0)
    )
    (tmp_path / "out").mkdir()
    output_error(Truth(), noisy).save(tmp_path / "out/fit.json")
    result = run(study, "-o", tmp_path / "out")
    assert result.exit_code == 2, result.output
    assert "it has changed, run casid identify again" in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--stick", "lat"], "expected NAME=NUMBER"),
        (["--stick", "lat=0"], "leaves nothing to fly"),
        (["--response", "q=1"], "limits name 'q'"),
        (["--feedback", "lat:q=1"], "feedback names 'q'"),
        (["--feedback", "lat=0.1"], "expected INPUT:OUTPUT=GAIN, such as lat:p=0.1"),
        (["--stick", "lta=0.1"], "did you mean 'lat'?"),
        (["--matter", "Lpp"], "did you mean 'Lp'?"),
        (["--feedback", "lat:p=-50"], "the loop is unstable with this feedback"),
        (["--feedback", "lat:p=nan"], "the gain of 'lat' by 'p' is nan"),
        (["--stick", "lat=inf"], "limit of stick 'lat' is infinite"),
        (["--rate", "lat=1e-7"], "raise that of its rate"),
        (["--duration", "nan"], "duration = nan s"),
        (["--duration", "0"], "duration = 0 s"),
        (["--duration", "1e6"], "fly that again"),
        (["--ardupilot", "lat=one:500"], "expected NAME=CHANNEL:US"),
        (["--method", "magic"], "method = 'magic'"),
        (["--spread", "-0.1"], "spread = -0.1: expected"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, options, words):
    result = run(write_study(tmp_path), "--duration", "12", *options)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--px4", "lat=q:1"], "'lat' on axis 'q'"),
        (["--px4", "lat=y:inf"], "the scale of 'lat' is inf"),
        (["--ardupilot", "ped=1:500"], "'ped' is in one of card and channels only"),
        (["--ardupilot", "lat=0:500"], "'lat' on RC channel 0"),
    ],
)
def test_what_no_autopilot_has_is_refused_before_anything_is_designed(
    tmp_path, monkeypatch, options, words
):
    monkeypatch.setattr("casid.commands.design.design_inputs", pytest.fail)
    result = run(write_study(tmp_path), *options)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


SWING = """
import casadi as ca

from casid import NonlinearModel, Scalar, parameter


class Swing(NonlinearModel):
    states, inputs, outputs = (STATES), ("m",), (OUTPUTS)
    k: Scalar = parameter(default=2.0, lower=0.1, upper=9.0, unit="1/s^2")
    c: Scalar = parameter(default=0.5, lower=0.0, upper=9.0, unit="1/s")

    def derivatives(self, x, u):
        return [u.m - self.k * ca.sin(x.theta) - self.c * x.q, x.qMORE]
"""
RECORDS = """
[model]
file = "swing.py:Swing"
[records.identification]
files = ["at_*.csv"]
[records.validation]
files = ["at_0.csv"]
[noise]
seed = 1
[noise.std]
q = 0.003
theta = 0.003
"""


def write_swing(folder, rests, speeds=()):
    """A study of a pendulum that hangs at angles, in total values; with speeds they are a state."""
    names, more = ('"q", "theta", "u"', ", 0.01 * x.q") if speeds else ('"q", "theta"', "")
    text = SWING.replace("STATES", names).replace("OUTPUTS", names).replace("MORE", more)
    (folder / "swing.py").write_text(text)
    t = 0.05 * np.arange(160)
    for number, rest in enumerate(rests):
        moment = 2.0 * np.sin(rest) + 0.1 * (t > 2)
        theta, q = rest + 0.2 * np.sin(t - 2) * (t > 2), 0.2 * np.cos(t - 2) * (t > 2)
        flown = (v + 0.01 * (theta - rest) for v in speeds[number:][:1])
        rows = np.column_stack([t, moment, q, theta, *flown])
        text = f"t,m,q,theta{',u' if speeds else ''}\n" + "\n".join(
            ",".join(map(str, row)) for row in rows.tolist()
        )
        (folder / f"at_{number}.csv").write_text(text + "\n")
    study = folder / "study.toml"
    extra = "u = 0.1\n" if speeds else ""
    study.write_text(RECORDS + extra + TABLE.replace("sticks = { lat = 0.02 }", ""))
    return study


@pytest.mark.second
def test_a_nonlinear_structure_is_designed_for_where_its_records_were_flown(tmp_path):
    result = run(write_swing(tmp_path, [0.8]), "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output
    card = (tmp_path / "out/design/card.csv").read_text().splitlines()
    largest = max(abs(float(row.split(",")[1])) for row in card[1:])
    # of deviations from rest, 0.1 and 0.2 rad, not of the total values 1.43 and 1.0
    assert 0.02 < largest <= 0.1 + 1e-9
    elsewhere = run(study := tmp_path / "study.toml", "--trim", "theta=0.2")
    assert elsewhere.exit_code == 0, elsewhere.output
    refused = run(study, "--trim", "alpha=0.2")
    told = "trim: no state or input is called 'alpha'; known are q, theta, m"
    assert told in " ".join(refused.stderr.split())


@pytest.mark.second
def test_of_several_speeds_the_one_to_fly_at_has_to_be_said(tmp_path):
    study = write_swing(tmp_path, [0.8, 0.3], speeds=[20.0, 40.0])
    result = run(study)
    assert result.exit_code == 2
    assert "flown at 2 speeds, 20, 40 m/s" in " ".join(result.stderr.split())
    assert "--trim u=20" in result.stderr
    result = run(study, "--trim", "u=38", "-o", tmp_path / "out")
    assert result.exit_code == 0, result.output


def test_a_linear_structure_has_its_own_trim(tmp_path):
    result = run(write_study(tmp_path), "--trim", "p=1")
    assert result.exit_code == 2
    assert "about its own trim" in " ".join(result.stderr.split())


@pytest.mark.slow
@pytest.mark.filterwarnings("always:.*earlier records, settings or casid")
def test_a_fit_of_earlier_records_is_told_and_one_that_was_changed_refused(tmp_path):
    study = write_study(tmp_path)
    run_study(read_study(study))
    study.write_text(study.read_text() + TABLE)  # no fit depends on it
    sound = run(study)
    assert sound.exit_code == 0, sound.output
    assert "earlier records" not in sound.stderr
    assert "is not sound" not in sound.output + sound.stderr
    fit = tmp_path / "out/fit.json"
    text = fit.read_text()
    value = json.loads(text)["model"]["fields"]["Lp"]
    fit.write_text(text.replace(f"{value}", f"{1.5 * value}"))
    changed = run(study)
    assert changed.exit_code == 2
    assert "changed after casid wrote it" in changed.stderr
    fit.write_text(text)
    kept = Fit.load(fit, model=type(read_study(study).model))
    replace(kept, cost=kept.cost + 1.0).save(fit)
    refused = run(study)
    assert refused.exit_code == 2
    assert "is not the fit that was kept in stages; run casid identify" in refused.stderr
    fit.write_text(text)
    record = tmp_path / "3211.csv"
    rows = [line.split(",") for line in record.read_text().splitlines()]
    rows[200][2] = f"{float(rows[200][2]) + 0.001}"
    record.write_text("\n".join(map(",".join, rows)) + "\n")
    stale = run(study)
    assert stale.exit_code == 0, stale.output
    assert "is of earlier records, settings or casid; run casid identify" in stale.stderr


@pytest.mark.parametrize(
    ("headlines", "theils", "success", "told"),
    [
        ({"Roll misses nothing that the records show": True}, (0.02, 0.3), True, ()),
        ({"Chosen: output error": None}, (), True, ()),
        ({"Roll misses something": False}, (0.02,), True, ("sound: Roll misses something. ",)),
        ({}, (0.02, 0.6), True, ("sound: it predicts y1 of unseen records poorly",)),
        ({}, (), False, ("sound: its estimation did not converge. Responses",)),
    ],
)
def test_a_design_tells_what_its_study_says_against_the_fit(
    tmp_path, headlines, theils, success, told
):
    figures = {"unit": "", "rms": 1.0, "fit": 0.0, "noise": 0.1, "residual": 0.1, "records": ()}
    judged = [Verdict(output=f"y{k}", theil=x, **figures) for k, x in enumerate(theils)]
    study, roll = read_study(write_study(tmp_path)), Truth()
    assert _doubts(study, roll) == ()  # a guess is no fit
    t = 0.05 * np.arange(100)
    lat = np.sin(t)[:, None]
    record = Record(t, lat, roll.system().simulate(t, lat), roll.inputs, roll.outputs)
    fit = replace(output_error(roll, [record], fixed=("Yv", "Lv", "Lp")), success=success)
    assert _doubts(study, replace(fit, success=True)) == ()  # nothing was said yet
    study.output.mkdir()
    fit.save(study.output / "fit.json")
    written = Written(timings=(), files=digests(study), verdicts=tuple(judged), headlines=headlines)
    keep_written(study, origin(study), written)
    said = _doubts(study, fit)
    assert len(said) == len(told)
    for each, words in zip(said, told, strict=True):
        assert words in each
    replace(fit, cost=fit.cost + 1.0).save(study.output / "fit.json")  # it was not said of that
    assert _doubts(study, replace(fit, success=True)) == ()


@pytest.mark.second
def test_a_fit_that_does_not_know_the_noise_leaves_it_to_the_study(tmp_path, monkeypatch):
    study = write_study(tmp_path)
    flown = read_records(read_study(study))["identification"][0]
    known = output_error(Truth(), flown.select(Truth.inputs, Truth.outputs))
    fit = replace(known, notes=replace(known.notes, K=np.zeros((3, 2))))
    monkeypatch.setattr("casid.commands.design._kept", lambda _: fit)
    text = study.read_text()
    study.write_text(text + TABLE)
    asked = []
    monkeypatch.setattr("casid.commands.design._noise", asked.append)
    run(study, "-o", tmp_path / "out")
    assert len(asked) == 1
    monkeypatch.setattr("casid.commands.design._kept", lambda _: known)
    assert run(study, "-o", tmp_path / "out").exit_code == 0
    assert len(asked) == 1


class Level(NonlinearModel):
    """u' = thr - c u²: thrust and speed balance."""

    states, inputs, outputs = ("u",), ("thr",), ("u",)

    c: Scalar = parameter(default=0.002, lower=0.0, upper=1.0, unit="1/m")

    def derivatives(self, x, u):
        return [u.thr - self.c * x.u**2]

    def reference(self):
        return {"u": 30.0, "thr": 1.8}


def test_a_condition_to_fly_does_not_move_with_the_parameters():
    t = 0.1 * np.arange(50)
    still = Record(t, np.full((50, 1), 1.8), np.full((50, 1), 30.0), ("thr",), ("u",), "level")
    trim, _ = _condition(Level(), [still], {"u": 32.0})
    assert trim.values == pytest.approx({"u": 32.0, "thr": 0.002 * 32**2})
    assert trim.moves == {}
