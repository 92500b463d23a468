"""What the README and the examples say is so."""

import re
import runpy
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.signal
from click.testing import CliRunner
from truths import uh60

from casid import DataWarning, Fit, output_error, validate
from casid.cli import main
from casid.commands.inspection import inspect_records
from casid.records import standard_deviations
from casid.structure.modelfile import load_model
from casid.studies.study import read_records
from casid.studies.studyfile import read_study

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
STUDY = re.search(r"```toml.*?\n(.*?)```", README, flags=re.DOTALL)[1]
SCRIPT, STRUCTURE = re.findall(r"```python.*?\n(.*?)```", README, flags=re.DOTALL)


def test_the_readme_opens_with_two_commands_that_the_makefile_has():
    opening = README[: README.index("## ")]
    commands = re.findall(r"^make (\w+)", opening, flags=re.MULTILINE)
    assert commands == ["study", "test"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in commands:
        assert re.search(rf"^{command}:", makefile, flags=re.MULTILINE)


def test_the_readme_says_what_the_makefile_does_for_those_without_make():
    assert "pip install -c constraints.txt .\n" in README
    assert "casid identify examples/uh60/study.toml\n" in README


@pytest.mark.slow
def test_the_script_of_the_readme_identifies_the_helicopter(monkeypatch, tmp_path):
    assert len([line for line in SCRIPT.splitlines() if line.strip()]) <= 15
    monkeypatch.chdir(ROOT)
    values = {}
    exec(compile(SCRIPT.replace("out/", f"{tmp_path}/"), "README.md", "exec"), values)
    fit, black_box = values["fit"], values["black_box"]
    assert fit.success
    assert (tmp_path / "six_dof.json").exists()
    # The aircraft's phugoid is 0.11 ± 0.43j rad/s (examples/uh60/data); the quasi-steady structure
    # and 16 s records leave it to within a tenth.
    phugoid = min(fit.model.system().poles(), key=lambda pole: abs(pole - (0.11 + 0.43j)))
    assert abs(phugoid - (0.11 + 0.43j)) < 0.1
    assert black_box.records == tuple(values["names"])


def test_the_structure_of_the_readme_is_declared_and_can_be_told_from_a_record(tmp_path):
    (tmp_path / "roll.py").write_text(STRUCTURE, encoding="utf-8")
    run = CliRunner().invoke(main, ["check", f"{tmp_path}/roll.py:Roll"])
    assert run.exit_code == 0, run.output
    assert "rank 3 of 3" in run.output
    # The closed form at s = 2j: Llat e^(-tau s) / (s - Lp).
    model = load_model("roll.py:Roll", tmp_path)(Lp=-3.0, Llat=8.0, tau=0.1)
    response = model.system().response(np.array([2.0]))[0, 0, 0]
    assert abs(response - 8.0 * np.exp(-0.2j) / (2j + 3.0)) < 1e-12


@pytest.mark.slow
def test_the_study_of_the_readme_finds_what_its_flights_were_made_from(tmp_path):
    (tmp_path / "roll.py").write_text(STRUCTURE, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    rng, t = np.random.default_rng(61), np.arange(0.0, 20.0, 0.02)
    for file, begin in (("flights/1.csv", 1.0), ("flights/2.csv", 2.5), ("unseen/3.csv", 2.0)):
        edges = begin + np.array([0.0, 3.0, 5.0, 6.0, 7.0])
        stick = np.interp(
            t, np.repeat(edges, 2) + np.tile([0.0, 0.04], 5), [0, 5, 5, -5, -5, 5, 5, -5, -5, 0]
        )  # %, 3-2-1-1
        late = np.interp(t - 0.1, t, stick, left=0.0) / 100
        rate = scipy.signal.lsim(([8.0], [1.0, 3.0]), late, t)[1]
        measured = np.rad2deg(rate) + rng.normal(0.0, 0.2, len(t))
        (tmp_path / file).parent.mkdir(exist_ok=True)
        np.savetxt(
            tmp_path / file,
            np.column_stack([t, stick, measured]),
            delimiter=",",
            header="t,lat,p",
            comments="",
        )
    run = CliRunner().invoke(main, ["identify", f"{tmp_path}/study.toml"])
    assert run.exit_code == 0, run.output
    structure = load_model("roll.py:Roll", tmp_path)
    fit = Fit.load(tmp_path / "out" / "fit.json", model=structure)
    for name, truth in {"Lp": -3.0, "Llat": 8.0, "tau": 0.1}.items():
        assert abs(fit[name].value - truth) < 4 * fit[name].std_error < 0.1 * abs(truth)


def test_every_link_of_the_readme_leads_to_a_file():
    for link in re.findall(r"\]\(([^)]+)\)", README):
        assert (ROOT / link).exists(), link


def test_the_citation_names_the_version_of_the_package():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {project['version']}\n" in citation


SCRIPTS = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.campaign  # .ci/run runs them as a user would
@pytest.mark.filterwarnings("ignore:.*measured responses are farther off:casid.DataWarning")
@pytest.mark.filterwarnings("ignore:output error. records contradict")  # six degrees of freedom do
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_an_example_runs_and_checks_itself(script, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "argv", [str(script)])
    runpy.run_path(str(script), run_name="__main__")


@pytest.mark.second
def test_the_study_of_the_uh60_reads_and_its_records_stay_in_their_roles():
    study = read_study(ROOT / "examples/uh60/study.toml")
    records = read_records(study)
    assert [record.name for record in records["validation"]] == ["validation_random"]
    for role in ("identification", "frequency", "refinement"):
        assert all(record.name != "validation_random" for record in records[role])
        assert study.roles[role].noise
    assert not study.roles["validation"].noise


@pytest.mark.slow
def test_the_black_box_of_the_uh60_has_the_response_of_its_linear_model():
    study = read_study(ROOT / "examples/uh60/study.toml")
    records = read_records(study)["identification"]
    known = uh60.oracle()
    found = study.settings["pbsid"].fit(records).system
    omega = np.geomspace(0.5, 12.0, 40)
    G, G_hat = known.response(omega), found.response(omega)
    u_std, y_std = standard_deviations(records)
    scale = u_std / y_std[:, None]
    error = np.linalg.norm(scale * (G_hat - G), axis=(1, 2)) / np.linalg.norm(
        scale * G, axis=(1, 2)
    )
    pairs = [(known.outputs.index(y), known.inputs.index(u)) for y, u in uh60.ON_AXIS]
    on_axis = [abs(G_hat[:, i, j] / G[:, i, j] - 1) for i, j in pairs]
    # Even noise-free the nonlinear records lie 8 and 3.3 % from the linear model.
    assert np.median(error) < 0.10
    assert np.median(on_axis) < 0.045


@pytest.fixture(scope="module")
def crazyflie():
    study = read_study(ROOT / "examples/crazyflie/study.toml")
    # One sample of all motor commands, where the set points change.
    with pytest.warns(DataWarning, match=r"B2_circle_fast_rep1: thrust jumps away from 20\.73"):
        return study, read_records(study)


@pytest.mark.slow
def test_the_quadrotor_is_identified_and_its_unseen_flights_explained(crazyflie):
    study, records = crazyflie
    with pytest.warns(DataWarning, match=r"later inputs \(roll, pitch, yaw\) follow them"):
        fit = output_error(study.model, records["identification"], interval=1.0)
    assert fit.success
    found = validate({"multirotor": fit}, records["validation"], horizon=np.inf)
    share = dict(zip(found.outputs, found.fit["multirotor"].T, strict=True))
    best = {"p": (26.6, 33.2), "q": (-2.8, 54.4), "phi": (60.3, 61.1), "theta": (40.9, 62.2)}
    # What the best of N4SID, CVA and PARSIM-K of all orders reach there: benchmarks/crazyflie.py.
    for name, peers in best.items():
        assert (share[name] > peers).all(), (name, share[name])
    flights = [record.resample(0.01) for record in records["validation"]]
    odd = [np.arange(record.N)[:, None] % 2 == 1 for record in flights]
    coarse = [replace(r, y=np.where(k, np.nan, r.y)) for r, k in zip(flights, odd, strict=True)]
    found = validate({"multirotor": fit}, coarse, horizon=1.0, closed_loop=True)
    share = dict(zip(found.outputs, found.fit["multirotor"].T, strict=True))
    # Theirs in closed loop, rounded up, from inputs and outputs at 50 Hz.
    best = {"p": (28.5, 28.5), "q": (29.5, 32.5), "phi": (60.5, 45.5), "theta": (57.5, 43.5)}
    for name, peers in best.items():
        assert (share[name] > peers).all(), (name, share[name])


@pytest.mark.slow
def test_attitudes_of_the_quadrotor_that_are_called_degrees_are_found(crazyflie):
    records = [record.cut(4.5, 16.0) for record in crazyflie[1]["identification"][:2]]
    scale = np.array([np.pi / 180 if y in {"phi", "theta"} else 1 for y in records[0].outputs])
    wrong = [replace(record, y=record.y * scale) for record in records]
    said = inspect_records(wrong, stated=("phi", "theta")).advice
    assert sum("its reference in radians though called degrees" in each for each in said) == 2
    said = inspect_records(records, stated=("phi", "theta")).advice
    assert not any("degrees" in each for each in said)
