"""Flights that obey rigid-body kinematics exactly, seen through instruments with known errors."""

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from casid import Record

G = 9.80665
RATES, FORCES = ("p", "q", "r"), ("ax", "ay", "az")
STATES = ("phi", "theta", "psi", "u", "v", "w")
NOISE = dict.fromkeys(RATES, 0.003) | dict.fromkeys(("phi", "theta", "psi"), 0.003)
NOISE |= dict.fromkeys(FORCES, 0.05) | dict.fromkeys(("u", "v", "w"), 0.2)

ERRORS = {  # scale, bias, skew
    "p": (0.08, 0.01, 0.06), "q": (-0.05, -0.004, -0.03), "r": (0.10, 0.006, 0.04),
    "ax": (0.05, 0.2, 0.03), "ay": (-0.06, 0.1, -0.04), "az": (0.04, 0.1, 0.02),
}  # fmt: skip


@cache
def truth(seed, duration=40.0, dt=0.02):
    """True signals of one manoeuvre as functions of time, and the instants of the record."""
    rng = np.random.default_rng(seed)
    omega = rng.uniform(0.4, 4.0, (6, 6))
    phase = rng.uniform(0, 2 * np.pi, (6, 6))
    size = np.repeat([0.06, 0.05, 0.05, 0.5, 0.5, 0.8], 6).reshape(6, 6)

    def moves(t):
        t = np.asarray(t)[..., None, None]
        return np.sum(size * np.sin(omega * (t - 2) + phase) * _begin(t), axis=-1)

    def drawn(t, x):
        # The speed is held near trim: by feedback, as a pilot would give.
        (_, _, _, u, v, w), (x_move, y_move, z_move) = x, np.moveaxis(moves(t)[..., 3:], -1, 0)
        return -0.3 * (u - 40) + x_move, -0.3 * v + y_move, -0.3 * (w - 2) + z_move

    def slope(t, x):
        phi, theta = x[:2]
        p, q, r = moves(t)[:3]
        s, c = np.sin(phi), np.cos(phi)
        turn = q * s + r * c
        return [p + turn * np.tan(theta), q * c - r * s, turn / np.cos(theta), *drawn(t, x)]

    def forces(t, x):
        (phi, theta, _, u, v, w), (u_dot, v_dot, w_dot) = x, drawn(t, x)
        p, q, r = np.moveaxis(moves(t)[..., :3], -1, 0)
        ax = u_dot + G * np.sin(theta) - r * v + q * w
        ay = v_dot - G * np.cos(theta) * np.sin(phi) - p * w + r * u
        az = w_dot - G * np.cos(theta) * np.cos(phi) - q * u + p * v
        return ax, ay, az

    t = dt * np.arange(-25, round(duration / dt) + 25)
    start = [0.02, 0.05, 0.3, 40.0, 0.0, 2.0]
    exact = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-10}
    path = solve_ivp(slope, (t[0], t[-1]), start, dense_output=True, **exact).sol

    def signals(at):
        x = path(at)
        return dict(zip((*RATES, *FORCES), [*moves(at)[:, :3].T, *forces(at, x)], strict=True)) | (
            dict(zip(STATES, x, strict=True))
        )

    return signals, t[25:-25]


def _begin(t):
    """Nothing for 2 s, then everything within another."""
    x = np.clip(t - 2, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)


def flight(seed=0, errors=None, noise=None, outputs=(*RATES, *FORCES, *STATES), name="flight"):
    """A record of one manoeuvre; ``errors`` is {channel: (scale, bias, skew)}."""
    signals, t = truth(seed)
    rng = np.random.default_rng([seed, 1])
    seen = cache(lambda skew: signals(t - skew))
    columns = []
    for channel in outputs:
        scale, bias, skew = (errors or {}).get(channel, (0.0, 0.0, 0.0))
        true = seen(skew)[channel]
        std = (noise or {}).get(channel, 0.0)
        columns.append((1 + scale) * true + bias + std * rng.standard_normal(len(t)))
    u = np.where(t > 2, 0.1, 0.0)[:, None]
    return Record(t, u, np.column_stack(columns), ("lat",), tuple(outputs), name)


def scores(check):
    """Errors of the estimates in units of their standard errors, (channels, 3)."""
    rows = []
    for each in check.channels:
        scale, bias, skew = ERRORS[each.channel]
        rows.append([
            (each.scale - scale) / each.scale_error, (each.bias - bias) / each.bias_error,
            (each.skew - skew) / each.skew_error,
        ])  # fmt: skip
    return np.array(rows)
