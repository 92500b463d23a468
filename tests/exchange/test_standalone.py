"""A model as a file that simulates without casid."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.signal

from casid.exchange.standalone import write_module

RUN = """
import json, sys
sys.path.insert(0, {folder!r})
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("casid", "scipy", "casadi", "control", "pandas"):
            raise ImportError(name)
sys.meta_path.insert(0, Blocked())
import numpy as np
import model
data = np.load({data!r})
y = model.simulate(data["t"], data["u"], data["x0"], {hold!r})
np.save({out!r}, y)
print(json.dumps([model.STATES, model.INPUTS, model.OUTPUTS, model.UNITS, list(model.DELAY)]))
"""


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("regular", [True, False])
def test_the_module_without_casid_simulates_what_casid_does(system, hold, regular, tmp_path):
    late = replace(system, delay=[0.0, 0.137])
    rng = np.random.default_rng(2)
    t = np.arange(300) * 0.02 if regular else np.cumsum(rng.uniform(0.01, 0.03, 300))
    u, x0 = rng.standard_normal((300, 2)), rng.standard_normal(3)
    write_module(tmp_path / "model.py", late, title='A "hostile" """ title\n\\')
    np.savez(tmp_path / "data.npz", t=t, u=u, x0=x0)
    names = {"folder": str(tmp_path), "data": str(tmp_path / "data.npz"), "hold": hold,
             "out": str(tmp_path / "y.npy")}  # fmt: skip
    run = subprocess.run(
        [sys.executable, "-c", RUN.format(**names)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    expected = late.simulate(t, u, x0, hold)
    # Another exponential and another order of additions: rounding of a sum of 300 terms.
    np.testing.assert_allclose(np.load(tmp_path / "y.npy"), expected, rtol=0,
                               atol=1e-12 * np.abs(expected).max())  # fmt: skip
    states, inputs, outputs, units, delay = json.loads(run.stdout)
    assert (states, inputs, outputs) == (["a", "b", "c"], ["lat", "ped"], ["p", "r"])
    assert units == {"lat": "travel", "ped": "travel", "p": "rad/s", "r": "rad/s"}
    assert delay == [0.0, 0.137]


def test_the_exponential_of_the_module_is_that_of_scipy(system, tmp_path):
    write_module(tmp_path / "model.py", system)
    namespace = {}
    exec(compile(Path(tmp_path / "model.py").read_text(), "model", "exec"), namespace)
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-9, 0.1, 3.0, 40.0):
        M = size * rng.standard_normal((8, 8)) / 8
        expected = scipy.linalg.expm(M)
        np.testing.assert_allclose(namespace["integrals"](M, np.ones(1))[0, 0], expected, rtol=0,
                                   atol=1e-12 * np.abs(expected).max())  # fmt: skip


def test_a_module_must_be_importable_and_continuous(system, tmp_path):
    for name in ("my-model.py", "class.py"):
        with pytest.raises(ValueError, match="name that Python imports"):
            write_module(tmp_path / name, system)
    with pytest.raises(ValueError, match=r"discrete with an interval of 0\.02 s"):
        write_module(tmp_path / "model.py", replace(system, dt=0.02))
    with pytest.raises(ValueError, match="hold='step', expected"):
        write_module(tmp_path / "model.py", system, hold="step")
    assert list(tmp_path.iterdir()) == []
