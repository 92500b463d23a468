"""What feedback makes of noise, against closed forms and against flights."""

import numpy as np
import pytest
import scipy

from casid.design.feedback_noise import deviations, peak
from casid.design.loop import Loop
from casid.free import free_parameters
from models.lateral_directional import LateralDirectional


def test_sticks_scatter_in_flights_of_the_loop_as_is_said():
    model, h = LateralDirectional(), 0.02
    K = np.zeros((len(model.inputs), len(model.outputs)))
    p = model.outputs.index("p")
    K[0, p] = 0.3 * np.sign(model.system().B[model.states.index("p"), 0])
    held = {model.inputs[0]: {"p": K[0, p]}}
    R = np.diag(np.linspace(0.01, 0.03, len(model.outputs)) ** 2)
    loop = Loop(free_parameters(model), held, R, h=h, N=3000)
    e = np.random.default_rng(4).multivariate_normal(np.zeros(len(R)), R, loop.N)
    u = loop.fly(-e @ K.T).u[:, 0]
    said = deviations(loop, K, R)
    # 3000 samples, of which few are correlated, tell a deviation to 1.3 %.
    assert u.std() == pytest.approx(said[0], rel=0.05)
    assert (np.diff(u) / h).std() == pytest.approx(said[len(K)], rel=0.05)
    # What noise does by the motion is small beside what it does at once: √2 K σ/h.
    assert said[len(K)] == pytest.approx(np.sqrt(2 * R[p, p]) * abs(K[0, p]) / h, rel=0.1)


def test_the_peak_of_noise_alone_is_the_quantile_of_a_gaussian_maximum():
    a = scipy.special.ndtri((1 + 0.9 ** (1 / 1500)) / 2)
    assert peak(np.zeros(1500), 0.3) == pytest.approx(0.3 * a, rel=1e-5)
    assert peak(np.array([0.2, -0.7]), 0.0) == 0.7


def test_nine_in_ten_flights_of_a_card_with_noise_stay_below_the_peak():
    rng, c = np.random.default_rng(8), np.sin(np.linspace(0, 9, 200))
    most = np.abs(c + 0.3 * rng.standard_normal((4000, 200))).max(axis=1)
    assert (most < peak(c, 0.3)).mean() == pytest.approx(0.9, abs=0.02)  # ± 0.005 by chance
