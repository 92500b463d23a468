"""A hover that obeys rigid-body kinematics, attitudes and velocities given in closed form.

Sums of sines move them about zero: forces are those that the velocities ask for, with nothing
integrated, so that all walks of a check come from the noise.
"""

import numpy as np

from casid import Record

G = 9.80665
MOVES = {  # highest frequency [Hz], standard deviation [rad, m/s]
    "phi": (0.8, 0.06), "theta": (0.8, 0.05), "psi": (0.3, 0.05),
    "u": (0.3, 0.10), "v": (0.3, 0.12), "w": (0.4, 0.08),
}  # fmt: skip
NAMES = ("ax", "ay", "az", "p", "q", "r", *MOVES)


def hover(seed, force, *, duration=80.0, dt=0.04, speed=0.03, still=()):
    """A record; white noise of ``force`` [m/s^2] a sample in ax ay az, of ``speed`` in u v w.

    What is ``still`` does not move.
    """
    rng = np.random.default_rng([5, seed])
    t = dt * np.arange(round(duration / dt))
    x, d = {}, {}
    for name, (f, std) in MOVES.items():
        omega, phase = 2 * np.pi * rng.uniform(f / 3, f, (6, 1)), rng.uniform(0, 6, (6, 1))
        size = (name not in still) * std / np.sqrt(3)
        x[name] = size * np.sin(omega * t + phase).sum(axis=0)
        d[name] = size * (omega * np.cos(omega * t + phase)).sum(axis=0)
    s, c, S, C = (f(x[n]) for n in ("phi", "theta") for f in (np.sin, np.cos))
    p = d["phi"] - d["psi"] * S
    q = d["theta"] * c + d["psi"] * C * s
    r = -d["theta"] * s + d["psi"] * C * c
    u, v, w = x["u"], x["v"], x["w"]
    ax = d["u"] + G * S - r * v + q * w
    ay = d["v"] - G * C * s - p * w + r * u
    az = d["w"] - G * C * c - q * u + p * v
    y = np.column_stack([ax, ay, az, p, q, r, *x.values()])
    noise = np.array([force] * 3 + [0.003] * 3 + [0.001] * 3 + [speed] * 3)
    y += noise * rng.standard_normal(y.shape)
    return Record(t, np.zeros((len(t), 0)), y, (), NAMES, "hover")
