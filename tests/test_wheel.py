"""What users get: the wheel, in a clean environment, far from the checkout."""

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from truths.roll_study import write_study

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder of the programs of an environment that holds the wheel and what it requires."""
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT)
    (wheel,) = folder.glob("casid-*.whl")
    venv.create(folder / "env", with_pip=True)
    programs = folder / "env" / ("Scripts" if os.name == "nt" else "bin")
    pins = ROOT / "constraints.txt"
    run(programs / "python", "-m", "pip", "install", "--quiet", "--constraint", pins, wheel)
    return programs


def run(*command, cwd=None):
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYTEST_ADDOPTS")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    quiet = {"PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment | quiet, text=True,
        capture_output=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.campaign
def test_the_installed_wheel_identifies_the_users_own_model(installed, tmp_path):
    study = write_study(tmp_path)
    where = run(installed / "python", "-c", "import casid; print(casid.__file__)", cwd=tmp_path)
    assert not Path(where.strip()).is_relative_to(ROOT / "casid")
    said = run(installed / "casid", "identify", study, "--parameters", cwd=tmp_path)
    assert "On unseen records" in said
    assert "Llat" in said
    for result in ("report.html", "fit.json", "parameters.csv", "figures/rms.svg"):
        assert (tmp_path / "out" / result).stat().st_size > 0


@pytest.mark.campaign
def test_the_wheel_carries_its_types_and_nothing_of_the_gallery(installed, tmp_path):
    program = (
        "import importlib.util, importlib.resources as r; "
        "print(r.files('casid').joinpath('py.typed').is_file(), "
        "importlib.util.find_spec('models'), importlib.util.find_spec('tests'))"
    )
    assert run(installed / "python", "-c", program, cwd=tmp_path).split() == [
        "True",
        "None",
        "None",
    ]
