"""The command line: what it prints, what it leaves behind, what its exit codes say."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from truths.roll_study import write_study

from casid.cli import COMMANDS, main


def casid(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


# ---- success -----------------------------------------------------------------------------------


def test_help_names_the_subcommands_and_the_exit_codes():
    result = casid("--help")
    assert result.exit_code == 0
    for word in ("identify", "check", "2 bad input", "3 a solver did not converge"):
        assert word in result.output


@pytest.mark.parametrize("command", ["identify", "check"])
def test_each_subcommand_explains_itself(command):
    result = casid(command, "--help")
    assert result.exit_code == 0
    assert "STUDY.toml" in result.output


@pytest.mark.second
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("asked", [["--help"], ["--version"], ["inspect", "--help"]])
def test_what_cannot_be_printed_is_one_line(asked):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "casid", *asked], stdout=full, stderr=subprocess.PIPE, text=True,
            check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "Cannot read or write: [Errno 28] No space left on device\n"


# ---- no convergence ----------------------------------------------------------------------------


@pytest.mark.second
def test_a_solver_that_stops_early_gives_code_three_and_keeps_what_there_was(tmp_path):
    limit = ("[match]\n", "[match]\nsolver = { max_iterations = 2 }\n")
    result = casid("identify", write_study(tmp_path, limit))
    assert result.exit_code == 3
    assert "No convergence" in result.stderr
    assert "max_iterations" in result.stderr
    stages = {path.name for path in (tmp_path / "out/stages").iterdir()}
    assert stages == {"pbsid.json", "quadratic_best.json"}
    best = json.loads((tmp_path / "out/stages/quadratic_best.json").read_text())
    assert best["success"] is False


@pytest.mark.slow
def test_after_a_failure_older_files_are_told_and_after_success_no_iterate_is_left(tmp_path):
    assert casid("identify", write_study(tmp_path)).exit_code == 0
    limit = ("[match]\n", "[match]\nsolver = { max_iterations = 2 }\n")
    failed = casid("identify", write_study(tmp_path, limit))
    assert failed.exit_code == 3
    told = "report.html, fit.json, parameters.csv and figures in"
    assert told in failed.stderr
    assert "are not of this run but of the last one that ended, 2" in failed.stderr
    best = tmp_path / "out/stages/quadratic_best.json"
    assert best.exists()
    assert casid("identify", write_study(tmp_path, ("order = 3", "order = 4"))).exit_code == 0
    assert not best.exists()


# ---- bad input ---------------------------------------------------------------------------------

STUDY_MISTAKES = {
    "an unknown channel": (('lat = "%"', 'latt = "%"'), ("latt",)),
    "an unknown unit": (('lat = "%"', 'lat = "furlong"'), ("lat", "furlong", "deg/s")),
    "an unknown key": (("order = 3", "ordre = 3"), ("[pbsid]", "ordre", "order")),
    "an unknown table": (("[pbsid]", "[pbsidd]"), ("pbsidd", "pbsid")),
    "a value of the wrong kind": (('title = "Roll near hover"', "title = 3"), ("title", "str")),
    "an empty role": (('files = ["random.csv"]', "files = []"), ("validation", "empty")),
    "a role without files": (('["random.csv"]', '["nothing*.csv"]'), ("nothing*.csv",)),
    "a missing role": (("[records.validation]", "[records.frequency]"), ("validation", "missing")),
    "a missing model": (('file = "roll.py:Roll"', ""), ("[model]", "file")),
    "no such model file": (("roll.py:Roll", "rool.py:Roll"), ("rool.py",)),
    "no such class": (("roll.py:Roll", "roll.py:Rol"), ("Rol", "Roll")),
    "a reference without class": (("roll.py:Roll", "roll.py"), ("file.py:ClassName",)),
    "lower > upper": (("[channels.units]", "[model.bounds]\nLp = [0, -9]\n[channels.units]"),
                      ("Lp", "lower", "upper")),
    "a bound of no parameter": (("[channels.units]", "[model.bounds]\nLq = [0, 1]\n"
                                 "[channels.units]"), ("Lq", "Lp")),
    "a value of no parameter": (("[channels.units]", "[model.values]\ng = 9\n[channels.units]"),
                                ("'g'", "Lp")),
    "noise without a seed": (("seed = 1", ""), ("[noise]", "seed")),
    "noise on no output": (("phi = 0.002", "psi = 0.002"), ("psi", "phi")),
    "a trim from nowhere": (('detrend = "identification"', 'detrend = "frequency"'),
                            ("trim", "frequency")),
    "a grid backwards": (("from = 0.5, to = 5", "from = 5, to = 0.5"), ("omega", "from < to")),
    "not TOML": (("[study]", "[study"), ("not TOML",)),
    "a record shorter than the kernels": (("past = 6", "past = 200"), ("record", "kernel")),
    "a stage's own refusal": (("order = 3", "order = 0"), ("order",)),
}  # fmt: skip


@pytest.mark.parametrize("mistake", STUDY_MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_a_mistake_in_the_study_gives_code_two_and_names_the_culprit(mistake, tmp_path):
    change, words = STUDY_MISTAKES[mistake]
    result = casid("identify", write_study(tmp_path, change))
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert said.startswith("Bad input:")
    for word in words:
        assert word in said


def _line(path, number, change):
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[number] = change(lines[number])
    path.write_text("\n".join(lines), encoding="utf-8")


DATA_MISTAKES = {
    "time not increasing": (lambda row: _cell(row, 0, "0"), ("time does not increase", "99")),
    "text in a column": (lambda row: _cell(row, 2, "fast"), ("not a table of numbers", "fast")),
}


def _cell(row, position, value):
    cells = row.split(",")
    cells[position] = value
    return ",".join(cells)


@pytest.mark.parametrize("mistake", DATA_MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_a_mistake_in_the_data_gives_code_two_and_names_the_culprit(mistake, tmp_path):
    change, words = DATA_MISTAKES[mistake]
    study = write_study(tmp_path)
    _line(tmp_path / "sweep.csv", 100, change)
    result = casid("identify", study)
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    assert "sweep" in said
    for word in words:
        assert word in said


def test_a_missing_column_is_named_with_those_there_are(tmp_path):
    study = write_study(tmp_path)
    _line(tmp_path / "3211.csv", 0, lambda _: "t,lat,p,bank")
    result = casid("check", study)
    assert result.exit_code == 2
    said = " ".join(result.stderr.split())
    assert "no column 'phi'; it has t, lat, p, bank" in said


MODEL_MISTAKES = {
    "does not parse": ("def A(self)", "def A(self", ("roll.py, line", "SyntaxError")),
    "does not import": ("class Roll", "import nothing_there\n\n\nclass Roll",
                        ("roll.py, line 7", "nothing_there")),
    "shapes disagree": ("[[0], [self.Llat], [0]]", "[[0], [self.Llat]]",
                        ("Roll.B", "(2, 1)", "(3, 1)")),
    "a name misspelt": ("self.Yv, 0", "self.Yw, 0", ("Roll.A", "Yw")),
    "lower > upper": ("lower=-10.0, upper=0.0", "lower=0.0, upper=-10.0",
                      ("Lp", "lower", "upper")),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MODEL_MISTAKES, ids=lambda name: name.replace(" ", "-"))
def test_a_mistake_in_the_model_file_gives_code_two_and_names_the_culprit(mistake, tmp_path):
    old, new, words = MODEL_MISTAKES[mistake]
    study = write_study(tmp_path)
    model = tmp_path / "roll.py"
    assert old in model.read_text(encoding="utf-8")
    model.write_text(model.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    result = casid("check", study)
    assert result.exit_code == 2, result.output
    said = " ".join(result.stderr.split())
    for word in words:
        assert word in said


def test_a_study_that_is_not_there_gives_code_two(tmp_path):
    result = casid("identify", tmp_path / "nothing.toml")
    assert result.exit_code == 2
    assert "nothing.toml" in " ".join(result.stderr.split())


# ---- starting ----------------------------------------------------------------------------------


def test_help_lists_every_command_and_imports_nothing_that_computes_or_draws():
    code = "from casid.cli import main; import sys; main(['--help'], standalone_mode=False)"
    run = subprocess.run([sys.executable, "-c", f"{code}; print(*sys.modules)"],
                         capture_output=True, text=True, check=True)  # fmt: skip
    *shown, modules = run.stdout.splitlines()
    listed = {line.split()[0] for line in shown[shown.index("Commands:") + 1 :] if line}
    assert listed == set(COMMANDS)
    heavy = {"casadi", "matplotlib", "plotly", "numpy", "scipy", "scipy.signal", "rich"}
    assert not heavy & set(modules.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_found_and_helps(name):
    result = casid(name, "--help")
    assert result.exit_code == 0
    assert result.output.startswith(f"Usage: main {name} ")


def test_an_unknown_command_is_refused():
    result = casid("identfy")
    assert result.exit_code == 2
    assert "No such command 'identfy'" in result.output
