"""Several flights of a rigid body at any speed, as instruments with one mistake see them.

Attitudes and velocities are integrated by SciPy from rates and specific forces, which a pilot
moves at random and who holds attitude and speed: nothing here is shared with casid.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from casid import Record

G = 9.80665
RATES, FORCES = ("p", "q", "r"), ("ax", "ay", "az")
ANGLES, SPEEDS = ("phi", "theta", "psi"), ("u", "v", "w")
ATTITUDES = ("phi", "theta")
WHOLE = (*RATES, *FORCES, *ATTITUDES, *SPEEDS)
BARE = (*RATES, *FORCES, *ATTITUDES)  # without velocities
NOISE = dict.fromkeys((*RATES, *ANGLES), 0.003) | dict.fromkeys(FORCES, 0.05)
NOISE |= dict.fromkeys(SPEEDS, 0.2)
SIZES = np.array([0.08, 0.06, 0.05, 0.6, 0.5, 0.8])  # of what moves rates and forces
REGIMES = {"hover": 0.5, "slow": 12.0, "cruise": 40.0, "fast": 65.0}  # m/s forward


def path(rng, speed, duration, share, theta0=0.05, phi0=-0.05):
    """Signals as functions of time from -1 s to 1 s after the end, of one flight.

    It is trimmed at ``theta0`` and ``phi0``, a helicopter's; ``share`` (6,) of the sizes moves
    rates and specific forces.
    """
    omega, phase = rng.uniform(0.4, 4.0, (6, 5)), rng.uniform(0, 2 * np.pi, (6, 5))
    size = (SIZES * share)[:, None]
    level = np.array([speed, 0.0, speed * np.tan(theta0)])

    def moved(t):
        begin = np.clip((np.asarray(t) - 1.5) / 1.0, 0.0, 1.0)
        waves = np.sin(omega * np.asarray(t)[..., None, None] + phase)
        return np.sum(size * waves, axis=-1) * (begin**2 * (3 - 2 * begin))[..., None]

    def motion(t, x):
        # Rates that hold the attitude, and accelerations that hold the speed.
        phi, theta, _, u, v, w = x
        m = moved(t).T
        held = [0.25 * (each - one) for each, one in zip((u, v, w), level, strict=True)]
        rates = m[0] - 0.7 * (phi - phi0), m[1] - 0.7 * (theta - theta0), m[2]
        return *rates, m[3] - held[0], m[4] - held[1], m[5] - held[2]

    def body(t, x):
        phi, theta, _, u, v, w = x
        p, q, r, u_dot, v_dot, w_dot = motion(t, x)
        s, c = np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)
        ax = u_dot + G * np.sin(theta) - r * v + q * w
        return p, q, r, ax, v_dot - G * s - p * w + r * u, w_dot - G * c - q * u + p * v

    def slope(t, x):
        phi, theta = x[:2]
        p, q, r, *accelerations = motion(t, x)
        turn = (q * np.sin(phi) + r * np.cos(phi)) / np.cos(theta)
        attitude = p + turn * np.sin(theta), q * np.cos(phi) - r * np.sin(phi), turn
        return [*attitude, *accelerations]

    start, span = [phi0, theta0, 0.3, *level], (-1.0, duration + 1.0)
    exact = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-9}
    states = solve_ivp(slope, span, start, dense_output=True, **exact).sol

    def signals(t):
        x = states(t)
        return dict(zip((*RATES, *FORCES, *ANGLES, *SPEEDS), (*body(t, x), *x), strict=True))

    return signals


def flown(
    seed, regime="cruise", late=None, outputs=WHOLE, *,
    count=3, duration=20.0, dt=0.02, noise=1.0, single=False,
):  # fmt: skip
    """Records of one campaign; ``late`` is {channel: s}, ``single``: one axis moves in each."""
    rng, records = np.random.default_rng([77, seed]), []
    for k in range(count):
        share = np.ones(6)
        if single:
            share = np.where(np.arange(6) % 3 == k % 3, 1.0, 0.1)
        signals = path(rng, REGIMES[regime], duration, share)
        t = dt * np.arange(round(duration / dt))
        at = cache(lambda skew, t=t, signals=signals: signals(t - skew))
        y = [at((late or {}).get(name, 0.0))[name] for name in outputs]
        y = [
            x + noise * NOISE[n] * rng.standard_normal(len(t))
            for n, x in zip(outputs, y, strict=True)
        ]
        u = np.where(t > 1.5, 0.1, 0.0)[:, None]
        records.append(Record(t, u, np.column_stack(y), ("lat",), tuple(outputs), f"r{k}"))
    return records


def changed(records, name, function):
    """The records, one channel through a function."""
    found = []
    for each in records:
        y, i = each.y.copy(), each.outputs.index(name)
        y[:, i] = function(y[:, i])
        found.append(replace(each, y=y))
    return found


def reversed_in(records, name):
    """The records, one channel with the opposite sign."""
    return changed(records, name, np.negative)


def dirty(records, seed, spikes=4, gone=0.01):
    """The records with outliers of 20 deviations, missing samples."""
    rng, found = np.random.default_rng([78, seed]), []
    for each in records:
        y, size = each.y.copy(), np.array([NOISE[name] for name in each.outputs])
        at, of = rng.integers(100, each.N - 100, spikes), rng.integers(0, each.ny, spikes)
        y[at, of] += 20 * size[of] * rng.choice([-1, 1], spikes)
        y[rng.random(y.shape) < gone] = np.nan
        found.append(replace(each, y=y))
    return found
