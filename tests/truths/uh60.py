"""The UH-60 records of the example and the linear model they can be checked against."""

import json
from pathlib import Path

import numpy as np

from casid import Record, StateSpace, read_csv
from models.six_dof import SixDof

EXAMPLE = Path(__file__).parents[2] / "examples" / "uh60"
INPUTS = ("col", "lat", "lon", "ped")
OUTPUTS = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")
NOISE = {"ax": 0.05, "ay": 0.05, "az": 0.1, "p": 0.003, "q": 0.003, "r": 0.003,
         "phi": 0.003, "theta": 0.003}  # fmt: skip
ON_AXIS = (("az", "col"), ("p", "lat"), ("q", "lon"), ("r", "ped"))
AMPLITUDE = {"col": 0.04, "lat": 0.04, "lon": 0.025, "ped": 0.05}  # of full travel


def sweeps(seed=None):
    """The four recorded sweeps; measurement noise of that seed."""
    rng = np.random.default_rng(seed)
    records = [
        read_csv(
            EXAMPLE / "data" / f"sweep_{name}.csv",
            inputs=INPUTS, outputs=OUTPUTS, units=dict.fromkeys(INPUTS, "%"), detrend="first",
        )
        for name in INPUTS
    ]  # fmt: skip
    return records if seed is None else [record.with_noise(NOISE, rng) for record in records]


def _trim():
    model = json.loads((EXAMPLE / "uh60_genhel_080kt.json").read_text())
    velocity = 0.3048 * np.array(model["trim_x0_ftlb"][:3])
    return model, velocity, model["trim_x0_ftlb"][7]


def oracle(delay=0.0):
    """32 states of rotor, inflow and body; specific forces and the rest as in the records."""
    model, (U0, V0, W0), theta0 = _trim()
    A = np.array(model["A"])
    order = [model["inputs"].index(name) for name in model["inputs"]]
    B = 100 * np.array(model["B"])[:, order][:, [2, 0, 1, 3]]  # stored as lat, lon, col, ped in %
    g = 9.80665
    C, D = np.zeros((8, 32)), np.zeros((8, 4))
    C[:3], D[:3] = A[:3], B[:3]
    C[0, [4, 5, 7]] += W0, -V0, g * np.cos(theta0)
    C[1, [3, 5, 6]] += -W0, U0, -g * np.cos(theta0)
    C[2, [3, 4, 7]] += V0, -U0, g * np.sin(theta0)
    C[3:, 3:8] = np.eye(5)
    return StateSpace(A, B, C, D, None, INPUTS, OUTPUTS, (), np.full(4, delay))


def structure():
    """The six-degrees-of-freedom structure at this trim."""
    _, (U0, V0, W0), theta0 = _trim()
    return SixDof(U0=U0, V0=V0, W0=W0, theta0=theta0)


def linear_sweep(axis, dt=0.02, duration=70.0):
    """A sweep of the 32-state model under the pilot-like feedback of the records, noise-free.

    Stick deviations follow r - K x through a first-order lag of 0.06 s; r is a logarithmic sweep
    from 0.3 to 15 rad/s.
    """
    t = dt * np.arange(round(duration / dt) + 1)
    since, span = np.clip(t - 3, 0, 62), 62.0
    rate = np.log(15 / 0.3)
    phase = 0.3 * span / rate * (np.exp(rate * since / span) - 1)
    fade = np.clip(np.minimum(since / 5, (65 - t) / 3), 0, 1)
    return _linear(axis, t, fade * np.sin(phase))


def linear_steps(axis):
    """A 3-2-1-1 of 16 s in the same loop."""
    t, unit = 0.02 * np.arange(801), 1.0 if axis == "col" else 0.7
    at = np.searchsorted([0, 3, 5, 6, 7], (t - 2) / unit, side="right")
    return _linear(axis, t, np.array([0.0, 1.0, -1.0, 1.0, -1.0, 0.0])[at])


def _linear(axis, t, command):
    """The 32-state model in its loop after a command to one axis."""
    r = np.zeros((len(t), 4))
    r[:, INPUTS.index(axis)] = AMPLITUDE[axis] * command
    plant, lag = oracle(), 0.06
    K = np.zeros((4, 32))  # per unit of travel and rad
    K[1, [3, 6]], K[2, [4, 7]], K[3, 5] = (0.05, 0.15), (0.20, 0.25), 0.20
    A = np.block([[plant.A, plant.B], [-K / lag, -np.eye(4) / lag]])
    B = np.vstack([np.zeros((32, 4)), np.eye(4) / lag])
    C = np.block([[plant.C, plant.D], [np.zeros((4, 32)), np.eye(4)]])
    closed = StateSpace(A, B, C, np.zeros((12, 4)))
    y = closed.simulate(t, r)
    return Record(t, y[:, 8:], y[:, :8], INPUTS, OUTPUTS, f"linear {axis}")
