"""The commands about files: what they print and leave behind, and their exit codes."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
from click.testing import CliRunner
from truths.climbing import AIRCRAFT
from truths.roll_study import write_study

from casid import FrequencyResponse, read_csv
from casid.cli import main
from casid.estimates import parameter_table
from casid.exchange.formats import read_table
from casid.fit import Fit
from casid.free import free_parameters
from casid.jobs.store import Done, Store
from casid.structure.modelfile import load_model

FLIGHT = Path(__file__).parents[2] / "examples/ah1s/data/3211_lat.csv"


def casid(*arguments):
    return CliRunner().invoke(main, [str(each) for each in arguments])


def refused(result):
    """What a command says when it refuses, on one line."""
    assert result.exit_code == 2, result.output
    return " ".join(result.stderr.split())


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The small study, a fit of its structure and a frequency response, as the working folder."""
    monkeypatch.chdir(tmp_path)
    write_study(tmp_path)
    model = load_model("roll.py:Roll", tmp_path)()
    free = free_parameters(model)
    values = np.array([-0.12, -0.06, -2.2, 10.0])  # those that made the records
    rows = parameter_table(free, values, np.zeros(4), np.full(4, 0.01))
    Fit(model=model.with_vector(values), parameters=rows, cost=1.0, status="", success=True,
        iterations=1, seconds=0.0, method="output error", notes=None,
        free_names=free.names).save("fit.json")  # fmt: skip
    G = np.ones((3, 2, 1), dtype=complex)
    FrequencyResponse(omega=np.array([1.0, 2.0, 3.0]), G=G, coherence=0.9 * np.ones((3, 2, 1)),
                      random_error=np.zeros((3, 2, 1)), inputs=("lat",), outputs=("p", "phi"),
                      input_std=np.ones(1), output_std=np.ones(2)).save("frf.json")  # fmt: skip
    return tmp_path


@pytest.mark.parametrize("command", ["convert", "inspect", "simulate", "new-model"])
def test_each_command_explains_itself(command):
    result = casid(command, "--help")
    assert result.exit_code == 0
    assert "Usage" in result.output
    assert len(result.output.splitlines()) > 6


# ---- convert -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("folder")
def test_a_record_goes_through_every_format_and_comes_back():
    for *more, source, target in (
        ("3211.csv", "a.mat"), ("a.mat", "b.parquet"),
        ("--mat-version", "7.3", "b.parquet", "c.mat"), ("c.mat", "c.csv"),
    ):  # fmt: skip
        assert casid("convert", source, target, *more).exit_code == 0
    before, after = read_table("3211.csv"), read_table("c.csv")
    assert set(before) == set(after)  # HDF5 sorts names
    for name in before:
        np.testing.assert_array_equal(before[name], after[name])


@pytest.mark.usefixtures("folder")
def test_a_unit_is_converted_on_the_way():
    assert casid("convert", "3211.csv", "si.csv", "--unit", "lat=%").exit_code == 0
    np.testing.assert_allclose(read_table("si.csv")["lat"], 0.01 * read_table("3211.csv")["lat"])


@pytest.mark.usefixtures("folder")
def test_a_fit_becomes_source_for_other_programs():
    model = ("--model", "roll.py:Roll")
    assert casid("convert", "fit.json", "roll.c", *model, "--dt", "0.02").exit_code == 0
    assert "Samples every 0.02 s" in Path("roll.c").read_text("utf-8")
    assert Path("roll.h").exists()


@pytest.mark.usefixtures("folder")
def test_a_response_becomes_a_table():
    assert casid("convert", "frf.json", "frf.csv").exit_code == 0
    assert read_table("frf.csv")["p_lat_coherence"].tolist() == [0.9, 0.9, 0.9]
    assert casid("convert", "frf.json", "frf.mat").exit_code == 0
    assert scipy.io.loadmat("frf.mat")["response"].shape == (2, 1, 3)


def test_the_response_a_study_measured_becomes_a_table(folder):
    (folder / "out").mkdir()
    measured = FrequencyResponse.load("frf.json")
    Store(folder / "out").put("frequency", "k", Done(result=measured))
    assert casid("convert", "out/frequency.json", "frf.csv").exit_code == 0
    assert read_table("frf.csv")["p_lat_coherence"].tolist() == [0.9, 0.9, 0.9]


def test_a_fit_becomes_matlab_and_a_module(folder):
    for target in ("fit.mat", "flown.py"):
        result = casid("convert", "fit.json", target, "--model", "roll.py:Roll")
        assert result.exit_code == 0, result.output
    assert scipy.io.loadmat("fit.mat")["A"].shape == (3, 3)
    run = subprocess.run([sys.executable, "-c", "import flown; print(flown.INPUTS)"],
                         capture_output=True, text=True, check=True, cwd=folder)  # fmt: skip
    assert "lat" in run.stdout


ROLL = ("--model", "roll.py:Roll")
CONVERT_MISTAKES = {
    "a fit without its structure": (("fit.json", "m.py"), ("--model",)),
    "another structure": (("fit.json", "m.py", "--model", "other.py:Roll"), ("other.py",)),
    "a fit as a table": (
        ("fit.json", "m.csv", "--model", "roll.py:Roll"),
        (".mat, .m, .py, .c or .fmu",),
    ),
    "C without an interval": (("fit.json", "m.c", "--model", "roll.py:Roll"), ("--dt 0.02",)),
    "a response as a module": (("frf.json", "m.py"), ("unknown suffix '.py'",)),
    "JSON of another kind": (
        ("other.json", "m.mat"),
        ("not a frequency response", "leaves one in"),
    ),
    "a file cut by semicolons": (("semi.csv", "a.mat"), ("separated by ';'", "commas")),
    "a file without header": (("bare.csv", "a.mat"), ("begins with numbers", "first line")),
    "a file that is not there": (("nothing.csv", "a.mat"), ("nothing.csv",)),
    "an unknown suffix": (("3211.csv", "a.xls"), ("'.xls'", ".parquet")),
    "a unit of no column": (("3211.csv", "a.csv", "--unit", "psi=deg"), ("no column 'psi'",)),
    "an unknown unit": (("3211.csv", "a.csv", "--unit", "lat=furlong"), ("furlong", "deg/s")),
    "a unit written wrongly": (
        ("3211.csv", "a.csv", "--unit", "p=degs"),
        ("did you mean 'deg/s'",),
    ),
    "C without end": (("fit.json", "m.c", *ROLL, "--dt", "inf"), ("3600 at most",)),
    "C at no rate": (("fit.json", "m.c", *ROLL, "--dt", "1e300"), ("3600 at most",)),
    "a folder that is not there": (("3211.csv", "new/a.csv"), ("no folder new", "make it")),
    "a unit without channel": (("3211.csv", "a.csv", "--unit", "deg"), ("CHANNEL=UNIT",)),
    "a unit for a fit": (("frf.json", "a.csv", "--unit", "p=deg"), ("SI already",)),
}


@pytest.mark.parametrize("mistake", CONVERT_MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_a_mistake_is_named_and_nothing_is_written(mistake, folder):
    (folder / "other.json").write_text("{}")
    (folder / "semi.csv").write_text("t;lat;p\n0;1;2\n1;2;3\n")
    (folder / "bare.csv").write_text("0,1,2\n1,2,3\n")
    arguments, words = CONVERT_MISTAKES[mistake]
    before = sorted(folder.iterdir())
    said = refused(casid("convert", *arguments))
    for word in words:
        assert word in said
    assert sorted(each for each in folder.iterdir() if each.name != "__pycache__") == before


# ---- inspect -----------------------------------------------------------------------------------


@pytest.mark.second
def test_inspect_shows_channels_sampling_and_kinematics():
    result = casid("inspect", FLIGHT)
    assert result.exit_code == 0, result.output
    for word in ("1000 samples", "every 0.02 s", "rad/s", "Correlation", "Kinematic", "theta"):
        assert word in result.output


@pytest.mark.usefixtures("folder")
def test_inspect_judges_a_model_and_takes_units():
    result = casid("inspect", "3211.csv", "sweep.csv", "--model", "roll.py:Roll", "--unit", "lat=%")
    assert result.exit_code == 0, result.output
    assert "rank 4 of 4" in result.output
    assert "can tell all parameters apart" in result.output


@pytest.mark.second
@pytest.mark.usefixtures("folder")
def test_inspect_reads_a_study_as_the_study_does():
    result = casid("inspect", "study.toml")
    assert result.exit_code == 0, result.output
    assert "rank 4 of 4" in result.output
    assert "alone" in refused(casid("inspect", "study.toml", "3211.csv"))


@pytest.mark.parametrize(
    "typed",
    [
        ("check", "--record", "3211.csv"), ("check", "--unit", "p=deg/s"), ("check", "--time", "T"),
        ("check", "--column", "p=P"), ("check", "--fixed", "Lp"), ("inspect", "--time", "T"),
        ("inspect", "--model", "roll.py:Roll"), ("inspect", "--outputs", "p"),
    ],
    ids=" ".join,
)  # fmt: skip
@pytest.mark.usefixtures("folder")
def test_what_a_study_says_itself_is_not_said_beside_it(typed):
    command, option, value = typed
    said = refused(casid(command, "study.toml", option, value))
    assert said.startswith(f"Bad input: {option} cannot be given with a study, which itself")


@pytest.mark.usefixtures("folder")
def test_options_of_records_ask_for_one():
    assert "add --record" in refused(casid("check", "roll.py:Roll", "--unit", "lat=%"))


def test_a_study_reads_parquet(folder):
    for file in ("3211", "sweep", "random"):
        assert casid("convert", f"{file}.csv", f"{file}.parquet").exit_code == 0
    text = (folder / "study.toml").read_text().replace(".csv", ".parquet")
    (folder / "study.toml").write_text(text)
    result = casid("check", "study.toml")
    assert result.exit_code == 0, result.output
    assert "The study is in order." in result.output


def test_inspect_asks_for_inputs_it_cannot_know(folder):
    casid("convert", "3211.csv", "a.csv")
    text = (folder / "a.csv").read_text().replace("lat", "stick", 1)
    (folder / "a.csv").write_text(text)
    said = refused(casid("inspect", "a.csv"))
    assert "--inputs" in said
    assert "stick" in said
    assert casid("inspect", "a.csv", "--inputs", "stick", "--outputs", "p").exit_code == 0


# ---- simulate ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("folder")
def test_simulate_compares_and_writes_histories():
    result = casid("simulate", "fit.json", "3211.csv", "--model", "roll.py:Roll", "--unit", "lat=%",
                   "-o", "sim.csv")  # fmt: skip
    assert result.exit_code == 0, result.output
    assert "Theil" in result.output
    table = read_table("sim.csv")
    flown = read_csv("3211.csv", inputs=["lat"], outputs=["p", "phi"], units={"lat": "%"})
    np.testing.assert_allclose(table["p"], flown.channel("p"), rtol=0, atol=1e-12)
    # The parameters are those that made the record, so what is left is its noise of 0.002.
    assert np.sqrt(np.mean((table["p_sim"] - table["p"]) ** 2)) < 0.004


@pytest.mark.usefixtures("folder")
def test_simulate_takes_columns_of_other_names(tmp_path):
    own = Path("3211.csv").read_text("utf-8").replace("lat", "STICK").replace(",p,", ",ROLL,")
    (tmp_path / "log.csv").write_text(own, encoding="utf-8")
    simulate = ("--model", "roll.py:Roll", "--unit", "lat=%")
    usual = casid("simulate", "fit.json", "3211.csv", *simulate).output
    renamed = ("--column", "lat=STICK", "--column", "p=ROLL")
    found = casid("simulate", "fit.json", tmp_path / "log.csv", *simulate, *renamed).output
    assert found.replace("log", "3211").split() == usual.split()


def test_simulate_needs_the_structure():
    assert "--model" in refused(casid("simulate", "fit.json", "3211.csv"))


@pytest.mark.usefixtures("folder")
def test_simulate_doubts_a_stick_beyond_full_travel():
    simulate = ("simulate", "fit.json", "3211.csv", "--model", "roll.py:Roll")
    assert "'lat' reaches 55, more than full travel; is it in %?" in casid(*simulate).output
    assert "reaches" not in casid(*simulate, "--unit", "lat=1").output


# ---- new-model ---------------------------------------------------------------------------------


@pytest.mark.usefixtures("folder")
def test_columns_units_and_time_of_a_log_are_told_to_inspect_and_check(tmp_path):
    rows = (tmp_path / "3211.csv").read_text().splitlines()
    header, rows = rows[0], [row.split(",") for row in rows[1:]]
    assert header == "t,lat,p,phi"
    lines = [f"{t},{u},{np.rad2deg(float(p))},{phi}" for t, u, p, phi in rows]
    (tmp_path / "log.csv").write_text("\n".join(["TIME,STICK,ROLL_RATE,phi", *lines]) + "\n")
    told = ["--unit", "lat=%", "--unit", "p=deg/s", "--time", "TIME"]
    told += ["--column", "lat=STICK", "--column", "p=ROLL_RATE"]
    plain = casid("check", "roll.py:Roll", "--record", "3211.csv", "--unit", "lat=%")
    renamed = casid("check", "roll.py:Roll", "--record", "log.csv", *told)
    assert renamed.exit_code == 0
    assert renamed.output == plain.output.replace("3211", "log")
    found = casid("inspect", "log.csv", "--inputs", "lat", *told)
    assert found.exit_code == 0
    assert "deg/s" not in found.output
    assert casid("inspect", "log.csv", "--column", "p").exit_code == 2
    unknown = casid("inspect", "log.csv", *told, "--column", "q=PITCH_RATE")
    assert unknown.exit_code == 2
    assert "log.csv: no column 'PITCH_RATE'" in unknown.output


@pytest.mark.filterwarnings("ignore:direct terms of delayed inputs")
def test_a_nonlinear_fit_becomes_what_other_tools_run(tmp_path, monkeypatch):
    fit = SimpleNamespace(model=AIRCRAFT, method="output error", notes=None, units={})
    monkeypatch.setattr("casid.commands.conversion.load_fit", lambda *_: fit)
    monkeypatch.chdir(tmp_path)
    Path("fit.json").write_text('{"casid": "fit"}', encoding="utf-8")
    Path("any.py").touch()
    for name, more, text in (
        ("flown.c", ("--dt", "0.02"), "total values"),
        ("flown.m", ("--pade", "3"), "function [dx, y] = flown(x, u)"),
        ("flown.py", ("--pade", "3"), "def equations(x, u):"),
    ):
        done = casid("convert", "fit.json", name, "--model", "any.py:Any", *more)
        told = ", inputs in straight lines" if name.endswith(".c") else ""
        assert done.output == f"{name}: Climbing after output error{told}\n"
        assert text in Path(name).read_text("utf-8")
    assert "pass pade=3" in refused(
        casid("convert", "fit.json", "flown.m", "--model", "any.py:Any")
    )
    held = casid("convert", "fit.json", "own.py", "--model", "any.py:Any", "--hold", "zoh")
    assert "--hold does not apply to own.py, a nonlinear fit" in refused(held)


# ---- what is read is not written over ------------------------------------------------------------

LOSSES = {
    "a record by its simulation": ("3211.csv", ("simulate", "fit.json", "3211.csv", *ROLL, "-o")),
    "a record by its units": ("3211.csv", ("convert", "3211.csv", "--unit", "lat=%")),
    "a model by its simulator": ("roll.py", ("convert", "fit.json", *ROLL)),
    "what a model imports": ("signs_of_roll.py", ("convert", "fit.json", *ROLL)),
}


@pytest.mark.second
@pytest.mark.parametrize("name", ["itself", "symbolic", "hard"])
@pytest.mark.parametrize("loss", LOSSES, ids=lambda name: name.replace(" ", "-"))
def test_no_output_replaces_what_it_is_made_from(loss, name, folder, monkeypatch):
    file, command = LOSSES[loss]
    (folder / "signs_of_roll.py").write_text("g = 9.80665\n", encoding="utf-8")
    (folder / "roll.py").write_text(
        "import signs_of_roll\n" + (folder / "roll.py").read_text("utf-8")
    )
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "signs_of_roll", raising=False)  # of another folder
    before, target = (folder / file).read_bytes(), folder / f"linked{Path(file).suffix}"
    if name == "itself":
        target = folder / "." / file
    elif name == "symbolic":
        target.symlink_to(file)
    else:
        target.hardlink_to(folder / file)
    assert "made from" in refused(casid(*command, target))
    assert target.read_bytes() == (folder / file).read_bytes() == before
    assert target.is_symlink() == (name == "symbolic")


def test_a_study_does_not_replace_its_records(folder):
    text = (folder / "study.toml").read_text("utf-8").replace("3211.csv", "parameters.csv")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    before = (folder / "3211.csv").rename("parameters.csv").read_bytes()
    assert "made from" in refused(casid("identify", "study.toml", "--output", "."))
    assert Path("parameters.csv").read_bytes() == before
    Path("design").mkdir()
    Path("design/card.csv").hardlink_to("parameters.csv")
    assert "made from" in refused(casid("design", "study.toml", "--output", "."))
