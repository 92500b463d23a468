"""Inputs between samples as a fit says, and options that say nothing about a file."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from click.testing import CliRunner
from truths.roll_study import write_study

from casid import Fit, NonlinearModel, Scalar, output_error, parameter, read_csv
from casid.channels import factor_of
from casid.cli import main
from casid.commands.conversion import hold_of
from casid.structure.modelfile import load_model

ROLL = ("--model", "roll.py:Roll")


def casid(*arguments):
    return CliRunner().invoke(main, [str(each) for each in arguments], terminal_width=400)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A fit of records whose inputs are held, and such a record, in the current folder."""
    monkeypatch.chdir(tmp_path)
    write_study(tmp_path)
    model = load_model("roll.py:Roll", tmp_path)
    channels = {"inputs": ("lat",), "outputs": ("p", "phi")}
    flown = read_csv("3211.csv", **channels, hold="zoh", units={"lat": "%"})
    truth = model().with_vector(np.array([-0.12, -0.06, -2.2, 10.0])).system()
    y = truth.simulate(flown.t, flown.u, hold="zoh")
    flown = replace(flown, y=y).with_noise({"p": 1e-3, "phi": 1e-3}, np.random.default_rng(0))
    output_error(model(), flown).save("fit.json")
    rows = np.column_stack([flown.t, flown.u, y])
    np.savetxt("held.csv", rows, delimiter=",", header="t,lat,p,phi", comments="", fmt="%.12g")
    return tmp_path


def test_a_fit_is_simulated_as_its_records_were_flown(folder):
    assert hold_of(Fit.load("fit.json", model=load_model("roll.py:Roll", folder))) == "zoh"
    own = casid("simulate", "fit.json", "held.csv", *ROLL, "--detrend", "none")
    other = casid("simulate", "fit.json", "held.csv", *ROLL, "--detrend", "none", "--hold", "foh")
    lines = (line for done in (own, other) for line in done.output.splitlines())
    rows = [line for line in lines if line.startswith("p ")]
    rms = [float(next(word for word in row.split() if word[0].isdigit())) for row in rows]
    assert len(rms) == 2, own.output
    assert rms[0] < 1e-3 < rms[1]


@pytest.mark.usefixtures("folder")
def test_source_holds_inputs_as_the_records_did():
    done = casid("convert", "fit.json", "own.c", *ROLL, "--dt", "0.02")
    assert done.output == "own.c: Roll after output error, inputs held between samples\n"
    done = casid("convert", "fit.json", "foh.c", *ROLL, "--dt", "0.02", "--hold", "foh")
    assert done.output.endswith("inputs in straight lines\n")


@pytest.mark.parametrize(("asked", "hold"), [((), "zoh"), (("--hold", "foh"), "foh")])
def test_a_module_holds_inputs_as_the_records_did(folder, asked, hold):
    done = casid("convert", "fit.json", "flown.py", *ROLL, *asked)
    told = {"zoh": "inputs held between samples", "foh": "inputs in straight lines"}[hold]
    assert done.output == f"flown.py: Roll after output error, {told}\n"
    text = (folder / "flown.py").read_text("utf-8")
    assert f'inputs are held as "{hold}" unless' in text
    flown = {}
    exec(compile(text, "flown", "exec"), flown)
    t = 0.1 * np.arange(40)
    u = np.where((t > 1) & (t < 2), 0.1, 0.0)[:, None]
    system = Fit.load("fit.json", model=load_model("roll.py:Roll", folder)).model.system()
    expected = system.simulate(t, u, hold=hold)
    found = flown["simulate"](t, u)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_where_nothing_says_so_inputs_are_straight_lines():
    assert hold_of(SimpleNamespace(notes=None)) == "foh"
    assert hold_of(SimpleNamespace(notes=SimpleNamespace(hold=None))) == "foh"


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("fit.json", "a.m", *ROLL, "--dt", "0.02"), "--dt does not apply to a.m, a linear fit"),
        (("fit.json", "a.c", *ROLL, "--pade", "3"), "--pade does not apply to a.c"),
        (("fit.json", "a.py", *ROLL, "--pade", "3"), "--pade does not apply to a.py"),
        (("fit.json", "a.m", *ROLL, "--hold", "zoh"), "--hold does not apply to a.m"),
        (("fit.json", "a.c", *ROLL, "--dt", "0.02", "--steps", "4"), "--steps does not apply to"),
        (("3211.csv", "a.mat", *ROLL), "--model does not apply to 3211.csv, a record"),
        (("3211.csv", "a.parquet", "--mat-version", "5"), "a.parquet, which is no .mat"),
        (("fit.json", "a.mat", *ROLL, "--mat-version", "5"), "numbers are in SI already"),
    ],
)
def test_an_option_that_says_nothing_about_a_file_is_refused(arguments, said):
    done = casid("convert", *arguments)
    assert done.exit_code == 2
    assert said in done.output


class Fast(NonlinearModel):
    """A roll mode that goes by the airspeed, which the reference does not."""

    states, inputs, outputs = ("u", "p"), ("push", "lat"), ("p",)

    Lp: Scalar = parameter(default=-0.2, lower=-5.0, upper=0.0, unit="1/m")

    def derivatives(self, x, u):
        return [u.push, self.Lp * x.u * (x.p - u.lat)]

    def reference(self):
        return {"u": 5.0}


def test_source_steps_by_the_speeds_that_were_flown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fit = SimpleNamespace(
        units={}, model=Fast(), method="output error",
        notes=SimpleNamespace(covered={"u": (10.0, 100.0)}, hold="foh"),
    )  # fmt: skip
    monkeypatch.setattr("casid.commands.conversion.load_fit", lambda *_: fit)
    (tmp_path / "fit.json").write_text('{"casid": "fit"}', encoding="utf-8")
    (tmp_path / "any.py").touch()
    given = ("--model", "any.py:Any", "--dt", "0.1")
    assert casid("convert", "fit.json", "fast.c", *given).exit_code == 0
    # 20 rad/s at 100 m/s, four steps within a radian.
    assert "8 Runge-Kutta steps a sample" in (tmp_path / "fast.c").read_text("utf-8")
    assert casid("convert", "fit.json", "own.c", *given, "--steps", "3").exit_code == 0
    assert "3 Runge-Kutta steps a sample" in (tmp_path / "own.c").read_text("utf-8")


@pytest.mark.parametrize(("unit", "share"), [("deg", "rad"), ("%", "travel"), ("pwm", "travel")])
def test_what_is_written_of_a_fit_names_the_unit_its_stick_was_read_in(folder, unit, share):
    cls = load_model("roll.py:Roll", folder)
    channels = {"inputs": ("lat",), "outputs": ("p", "phi")}
    table = np.loadtxt("held.csv", delimiter=",", skiprows=1)
    table[:, 1] /= factor_of("lat", unit)
    np.savetxt("own.csv", table, delimiter=",", header="t,lat,p,phi", comments="", fmt="%.12g")
    flown = read_csv("own.csv", **channels, units={"lat": unit}, hold="zoh")
    output_error(cls(), flown).save("fit.json")
    assert Fit.load("fit.json", model=cls).units == ({"lat": "rad"} if share == "rad" else {})
    for name, more in (("own.py", ()), ("own.m", ("--pade", "3")), ("own.c", ("--dt", "0.02"))):
        done = casid("convert", "fit.json", name, *ROLL, *more)
        assert done.exit_code == 0, done.output
        said = (folder / name).read_text(encoding="utf-8")
        assert (f"'lat': '{share}'" if name == "own.py" else f"lat [{share}]") in said
        assert "from the trim" in said or "from trim" in said or "about the trim" in said
    assert casid("convert", "fit.json", "own.mat", *ROLL).exit_code == 0
    assert scipy.io.loadmat("own.mat")["input_units"][0, 0].item() == share
