"""The UH-60 records, their references and the two error figures that benchmarks quote.

    e(ω) = ‖S_y⁻¹ (Ĝ - G) S_u‖_F / ‖S_y⁻¹ G S_u‖_F        S: standard deviations over the records

and, on axis, abs(ĝ/g - 1) for col -> az, lat -> p, lon -> q, ped -> r; medians over 40 log-spaced
points in 0.5-12 rad/s.
"""

import json
from pathlib import Path

import numpy as np

from casid import Record, StateSpace, read_csv
from casid.records import standard_deviations

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "examples" / "uh60" / "data"
ORACLE = ROOT / "examples" / "uh60" / "uh60_genhel_080kt.json"

INPUTS = ("col", "lat", "lon", "ped")
OUTPUTS = ("ax", "ay", "az", "p", "q", "r", "phi", "theta")
NOISE = dict(zip(OUTPUTS, (0.05, 0.05, 0.1, 0.003, 0.003, 0.003, 0.003, 0.003), strict=True))
STEPS = tuple(f"3211_{axis}" for axis in INPUTS)
SWEEPS = tuple(f"sweep_{axis}" for axis in INPUTS)
ON_AXIS = (("az", "col"), ("p", "lat"), ("q", "lon"), ("r", "ped"))
OMEGA = np.geomspace(0.5, 12.0, 40)
ORACLE_DELAY = 0.004  # s, of the records against the oracle


def nonlinear_records(names, seed=None):
    """The recorded manoeuvres, perturbations from their trim, with noise unless seed is None."""
    records = [
        read_csv(DATA / f"{name}.csv", inputs=INPUTS, outputs=OUTPUTS, detrend="first")
        for name in names
    ]
    return with_noise(records, seed)


def with_noise(records, seed):
    if seed is None:
        return records
    rng = np.random.default_rng(seed)
    return [record.with_noise(NOISE, rng) for record in records]


def oracle(delay=0.0):
    """The 32-state linear model as StateSpace with casid's channels."""
    content = json.loads(ORACLE.read_text())
    A = np.array(content["A"])
    B = np.array(content["B"])[
        :, [2, 0, 1, 3]
    ]  # stored as lateral, longitudinal, collective, pedal
    U0, V0, W0 = 0.3048 * np.array(content["trim_x0_ftlb"][:3])
    theta0, g = content["trim_x0_ftlb"][7], 9.80665
    C = np.zeros((8, len(A)))
    C[:3], D = A[:3], np.zeros((8, 4))
    D[:3] = B[:3]
    C[0, 4] += W0
    C[0, 5] -= V0
    C[0, 7] += g * np.cos(theta0)
    C[1, 3] -= W0
    C[1, 5] += U0
    C[1, 6] -= g * np.cos(theta0)
    C[2, 3] += V0
    C[2, 4] -= U0
    C[2, 7] += g * np.sin(theta0)
    C[3:, 3:8] = np.eye(5)
    return StateSpace(A, B, C, D, None, INPUTS, OUTPUTS, (), np.full(4, delay))


def linear_records(names, seed=None):
    """Records of the same tests flown on the 32-state model in the same kind of loop."""
    plant = oracle()
    n, nu, lag = plant.nx, plant.nu, 0.06
    K = np.zeros((nu, n))
    K[1, 3], K[1, 6] = 5, 15
    K[2, 4], K[2, 7] = 20, 25
    K[3, 5] = 20
    A = np.block([[plant.A, plant.B], [-K / lag, -np.eye(nu) / lag]])
    B = np.vstack([np.zeros((n, nu)), np.eye(nu) / lag])
    C = np.block([[np.zeros((nu, n)), np.eye(nu)], [plant.C, plant.D]])
    loop = StateSpace(A, B, C, np.zeros((nu + plant.ny, nu)))
    records = []
    for name in names:
        kind, axis = name.split("_")
        t = np.arange(0, 16 if kind == "3211" else 70, 0.02)
        r = np.zeros((len(t), nu))
        i = INPUTS.index(axis)
        amplitude = {"lat": 4.0, "lon": 2.5, "col": 4.0, "ped": 5.0}[axis]
        r[:, i] = amplitude * (steps(t, axis) if kind == "3211" else sweep(t))
        out = loop.simulate(t, r)
        records.append(Record(t, out[:, :nu], out[:, nu:], INPUTS, OUTPUTS, f"{name} linear"))
    return with_noise(records, seed)


def steps(t, axis):
    """3-2-1-1 of unit amplitude from t = 2 s."""
    unit = 1.0 if axis == "col" else 0.7
    position = (t - 2) / unit
    signal = np.select(
        [position < 0, position < 3, position < 5, position < 6, position < 7], [0, 1, -1, 1, -1], 0
    )
    return signal.astype(float)


def sweep(t):
    """Logarithmic sweep 0.3-15 rad/s over 62 s from t = 3 s, faded in and out."""
    low, high, T = 0.3, 15.0, 62.0
    s = np.clip(t - 3, 0, T)
    ratio = np.log(high / low)
    phase = low * T / ratio * (np.exp(s * ratio / T) - 1)
    fade = np.clip(s / 5, 0, 1) * np.clip((T - s) / 3, 0, 1)
    return fade * np.sin(phase)


def best_linear_approximation():
    """Response of a long ARX model of all eight noise-free records."""
    return long_autoregression(nonlinear_records(STEPS + SWEEPS))


def long_autoregression(records):
    """Response on `OMEGA` of an ARX model of 50 lags of every second sample of records."""
    records = [record.decimate(2) for record in records]
    lags, dt = 50, records[0].dt
    rows, targets = [], []
    for record in records:
        z = np.hstack([record.y, record.u])
        past = [z[lags - k : len(z) - k] for k in range(1, lags + 1)]
        rows.append(np.hstack([*past, record.u[lags:]]))
        targets.append(record.y[lags:])
    Phi, Y = np.vstack(rows), np.vstack(targets)
    scale = np.std(Phi, axis=0)
    theta = np.linalg.lstsq(Phi / scale, Y, rcond=1e-9)[0] / scale[:, None]
    ny, nu = len(OUTPUTS), len(INPUTS)
    z = np.exp(1j * OMEGA * dt)
    left = np.broadcast_to(np.eye(ny, dtype=complex), (len(OMEGA), ny, ny)).copy()
    right = np.broadcast_to(theta[-nu:].T.astype(complex), (len(OMEGA), ny, nu)).copy()
    for k in range(1, lags + 1):
        block = theta[(k - 1) * (ny + nu) : k * (ny + nu)].T
        left -= block[:, :ny] * z[:, None, None] ** -k
        right += block[:, ny:] * z[:, None, None] ** -k
    return np.linalg.solve(left, right)


def errors(G_hat, G, records):
    """Median e(ω) and median on-axis error of Ĝ against G, both on `OMEGA`; NaN counts in none."""
    su, sy = standard_deviations(records)
    scale = su[None, None, :] / sy[None, :, None]
    off, size = ((np.abs(np.where(np.isnan(G_hat), 0.0, X)) * scale) ** 2 for X in (G_hat - G, G))
    e = np.sqrt(off.sum(axis=(1, 2)) / size.sum(axis=(1, 2)))
    pairs = [(OUTPUTS.index(y), INPUTS.index(u)) for y, u in ON_AXIS]
    on_axis = [np.nanmedian(np.abs(G_hat[:, i, j] / G[:, i, j] - 1)) for i, j in pairs]
    return float(np.median(e)), float(np.median(on_axis))
