"""A helicopter's heave and pitch with a collective felt at once in the load factor, by exact steps.

Inputs held in steps and delayed by no whole samples: an accelerometer's samples jump wherever one
of their own passes a step, and tell nothing of the delay in between.
"""

from itertools import pairwise

import numpy as np
import scipy.linalg

from casid import Model, Record, Rows, Scalar, parameter

NOISE = np.array([0.3, 0.01])


class Heave(Model):
    """Heave and pitch; the accelerometer hears the collective."""

    states, inputs, outputs = ("w", "q"), ("lon", "col"), ("az", "q")
    Zw: Scalar = parameter(default=-0.8, lower=-3, upper=0, unit="1/s")
    Mw: Scalar = parameter(default=-0.04, lower=-1, upper=1, unit="rad/(s*m)")
    Mq: Scalar = parameter(default=-1.5, lower=-6, upper=3, unit="1/s")
    Mlon: Scalar = parameter(default=8.0, lower=0, upper=30, unit="rad/s^2")
    Zcol: Scalar = parameter(default=-80.0, lower=-200, upper=0, unit="m/s^2")
    tlon: Scalar = parameter(default=0.083, lower=0, upper=0.3, unit="s")
    tcol: Scalar = parameter(default=0.117, lower=0, upper=0.3, unit="s")

    def A(self) -> Rows:
        return [[self.Zw, 20.0], [self.Mw, self.Mq]]

    def B(self) -> Rows:
        return [[0, self.Zcol], [self.Mlon, 0]]

    def C(self) -> Rows:
        return [[self.Zw, 0], [0, 1]]

    def D(self) -> Rows:
        return [[0, self.Zcol], [0, 0]]

    def delays(self) -> dict[str, Scalar]:
        return {"lon": self.tlon, "col": self.tcol}


def heaved(masked=True, steps=(0.02, 0.04)):
    """Noisy records of these sampling intervals [s]; a tenth of the samples lost, if masked."""
    rng, found = np.random.default_rng(0), []
    for k, h in enumerate(steps):
        t = h * np.arange(round((12 + 3 * k) / h) + 1)
        u = np.stack([_doublets(t, 1.0), _doublets(t, 5.0)][:: 1 - 2 * k], axis=1)
        y = _exact(t, u) + NOISE * rng.standard_normal((len(t), 2))
        if masked:
            y[rng.random(y.shape) < 0.1] = np.nan
        found.append(Record(t, u, y, Heave.inputs, Heave.outputs, f"record {k}", hold="zoh"))
    return found


def _doublets(t, begin):
    """A 3-2-1-1 of 0.03."""
    edges = begin + np.array([0.0, 0.9, 1.5, 1.8, 2.1]) - 1e-9
    return 0.03 * np.array([0, 1, -1, 1, -1, 0])[np.searchsorted(edges, t)]


def _exact(t, u):
    """Outputs (N, 2): the matrix exponential from edge to edge of what arrives late."""
    m = Heave()
    A, B, C, D = (np.array(each, dtype=float) for each in (m.A(), m.B(), m.C(), m.D()))
    late = np.array([m.tlon, m.tcol])
    edges = np.unique(np.round(np.concatenate([t, *(t + each for each in late)]), 9))
    edges = edges[edges <= t[-1] + 1e-9]

    def arrived(now):
        at = np.searchsorted(t, now - late + 1e-7, side="right") - 1
        return u[np.maximum(at, 0), [0, 1]]

    x, states = np.zeros(2), {0.0: np.zeros(2)}
    for now, then in pairwise(edges):
        block = np.zeros((4, 4))
        block[:2, :2], block[:2, 2:] = A, B
        x = (scipy.linalg.expm(block * (then - now)) @ [*x, *arrived(now)])[:2]
        states[float(then)] = x
    return np.array([C @ states[float(f"{now:.9f}")] + D @ arrived(now) for now in t])
