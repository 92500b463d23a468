"""Model files to start from."""

import subprocess
import sys

import pytest
from click.testing import CliRunner

from casid.cli import main


def casid(*arguments):
    return CliRunner().invoke(main, [str(each) for each in arguments])


def refused(result):
    """What a command says when it refuses, on one line."""
    assert result.exit_code == 2, result.output
    return " ".join(result.stderr.split())


@pytest.mark.parametrize("name", ["my_roll", "hover2.py"])
def test_a_new_model_passes_the_check(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = casid("new-model", name)
    assert result.exit_code == 0
    reference = result.output.split()[-1]
    checked = casid("check", reference)
    assert checked.exit_code == 0, checked.output
    assert "rank 5 of 5" in checked.output


def test_a_new_model_has_no_finding_of_ruff(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    casid("new-model", "my_roll")
    run = subprocess.run([sys.executable, "-m", "ruff", "check", "--isolated", "my_roll.py"],
                         capture_output=True, text=True, check=False)  # fmt: skip
    assert run.returncode == 0, run.stdout


def test_a_new_model_never_overwrites(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("precious")
    assert "there already" in refused(casid("new-model", "mine"))
    assert (tmp_path / "mine.py").read_text() == "precious"


@pytest.mark.parametrize(
    "name", ["", ".", "numpy", "json", "2fast", "a-b", "class", "nowhere/mine", "model", "_", "ÿes"]
)
def test_a_name_python_does_not_take_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refused(casid("new-model", name)).startswith("Bad input")
    assert list(tmp_path.iterdir()) == []
