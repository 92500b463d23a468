"""A system and a record to hand to other tools, and Octave to read what MATLAB would."""

import shutil
import subprocess

import numpy as np
import pytest
import scipy.io

from casid import Record, StateSpace

# Inputs are straight lines between samples, then late; steps of the solver end at every kink.
SOLVER = """
function y = simulate(f, h, t, u, x0, delay)
  late = @(s) arrayfun(@(j) interp1(t, u(:, j), min(max(s - delay(j), 0), t(end))), 1:columns(u))';
  kinks = unique([t; reshape(t + delay(:)', [], 1)]);
  kinks = kinks([true; diff(kinks) > 1e-9] & kinks <= t(end) + 1e-9);
  x = x0(:); y = zeros(0, numel(h(x, late(0)))); settings = odeset('RelTol', 1e-9, 'AbsTol', 1e-10);
  for k = 1:numel(kinks)
    if min(abs(t - kinks(k))) < 1e-9
      y(end + 1, :) = h(x, late(kinks(k)));
    end
    if k < numel(kinks)
      from = late(kinks(k)); slope = (late(kinks(k + 1)) - from) / (kinks(k + 1) - kinks(k));
      own = @(s, x) f(x, from + slope * (s - kinks(k)));
      [~, states] = ode45(own, kinks(k:k + 1), x, settings);
      x = states(end, :)';
    end
  end
end
"""


@pytest.fixture
def octave(tmp_path):
    """Run statements in Octave, among the files of the test; what they leave in ``y``."""
    program = shutil.which("octave-cli")
    if program is None:
        pytest.skip("no Octave")

    def run(statements, **given):
        scipy.io.savemat(tmp_path / "given.mat", given)
        script = f"1;\n{SOLVER}\nload given.mat;\n{statements}\nsave -v7 found.mat y;\n"
        (tmp_path / "script.m").write_text(script, "utf-8")
        command = [program, "--norc", "--quiet", "script.m"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return scipy.io.loadmat(tmp_path / "found.mat")["y"]

    return run


@pytest.fixture
def system():
    rng = np.random.default_rng(4)
    A = rng.standard_normal((3, 3)) - 2 * np.eye(3)
    B, C, D = (rng.standard_normal(shape) for shape in ((3, 2), (2, 3), (2, 2)))
    return StateSpace(A, B, C, D, None, ("lat", "ped"), ("p", "r"), ("a", "b", "c"))


@pytest.fixture
def record():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.01, 0.03, 50))
    y = rng.standard_normal((50, 2))
    y[7, 1] = np.nan
    u = rng.standard_normal((50, 1))
    raw = Record(t, u, y, ("lat",), ("p", "phi"), "a flight", "zoh")
    return raw.detrend({"lat": 0.5, "p": 0.01, "phi": -0.02})
