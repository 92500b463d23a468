"""Every structure of the gallery is recovered from its own simulation."""

from dataclasses import replace

import numpy as np
import pytest

from casid import Record, match, output_error, validate
from casid.model import free_parameters
from models.heave_inflow import HeaveInflow
from models.hybrid_flap import HybridFlap
from models.hybrid_flap_lag import HybridFlapLag
from models.lateral_directional import LateralDirectional
from models.longitudinal import Longitudinal
from models.short_period import ShortPeriod
from models.six_dof import SixDof
from tests.truth import known_black_box

GALLERY = [
    HeaveInflow, HybridFlap, HybridFlapLag, LateralDirectional, Longitudinal, ShortPeriod, SixDof
]  # fmt: skip


def somewhere(structure, seed=1, share=0.005):
    """A truth near the file's defaults: every parameter moved by a share of its bounds' width."""
    free = free_parameters(structure())
    width = np.where(np.isfinite(free.upper - free.lower), free.upper - free.lower, 1.0)
    step = share * width * np.random.default_rng(seed).standard_normal(len(width))
    inside = np.clip(structure().vector() + step, free.lower + 0.01 * width, free.upper - 0.01 * width)
    return structure().with_vector(inside)


def off(truth, share=0.3, seed=5):
    """A start that is wrong by a share of every value, and of a hundredth of its bounds' width."""
    free = free_parameters(truth)
    rng = np.random.default_rng(seed)
    values = truth.vector() * (1 + share * rng.choice([-1, 1], len(free.lower)))
    return truth.with_vector(np.clip(values, free.lower, free.upper))


def steps(t, unit=0.7):
    """3-2-1-1 from t = 1 s, its edges one sample wide."""
    edges = 1 + unit * np.array([0, 3, 5, 6, 7])
    levels = np.array([0, 1, -1, 1, -1, 0])
    return 0.05 * levels[np.searchsorted(edges, t, side="right")]


def flown(truth, duration=12.0, dt=0.04):
    """One 3-2-1-1 a control, smoothed by a stick's lag so that a spline can carry its delay."""
    t = dt * np.arange(int(duration / dt))
    system = truth.system()
    records = []
    for i, name in enumerate(system.inputs):
        u = np.zeros((len(t), system.nu))
        for unit in (0.7, 0.3):
            u[:, i] += smooth(steps(t, unit), dt)
        y = system.simulate(t, u)
        records.append(Record(t, u, y, system.inputs, system.outputs, name))
    return records


def smooth(signal, dt, lag=0.1):
    """Two first-order lags."""
    a = np.exp(-dt / lag)
    for _ in range(2):
        out = np.zeros_like(signal)
        for k in range(1, len(signal)):
            out[k] = a * out[k - 1] + (1 - a) * signal[k]
        signal = out
    return signal


@pytest.mark.parametrize("structure", GALLERY, ids=lambda structure: structure.__name__)
def test_a_structure_is_recovered_from_its_own_response(structure):
    truth = somewhere(structure)
    target = known_black_box(truth.system(), band=(0.3, 20.0))
    fit = match(off(truth), target, norm="quadratic")
    scale = free_parameters(truth).scale
    # The solver's tolerance, 1e-8 on the scaled problem, over the square root of its curvature.
    np.testing.assert_allclose((fit.model.vector() - truth.vector()) / scale, 0, atol=1e-5)
