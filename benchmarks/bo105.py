"""The Bo105 at 80 kn of G. D. Padfield, Helicopter Flight Dynamics, 2nd ed., appendix 4B.

Eight states; the published stability and control matrices are read into `SixDof` with
U0 = 41.15 m/s and zero trim attitude. Controls are published per rad of blade pitch; here a full
travel of every stick is 0.25 rad, lateral positive to the right. Records are 3-2-1-1 manoeuvres
flown under attitude and rate feedback, as the aircraft is unstable; every control is 40 ms late.
"""

import numpy as np

from casid import Record, StateSpace
from casid.linear import foh_step
from models.six_dof import SixDof

U0 = 41.15  # m/s
TRAVEL = 0.25  # rad of blade pitch per full travel
DELAY = 0.04  # s, of every control

# Rows and columns as printed: u w q theta v p phi r.
A = np.array([
    [-0.0325, -0.0041, 1.5364, -9.8084, -0.0003, 0.0505, 0.0, 0.0],
    [-0.0394, -0.826, 41.0254, 0.2001, -0.0116, -0.3738, 0.2705, 0.0],
    [0.0309, 0.0195, -3.9954, 0.0, 0.0029, -0.2254, 0.0, 0.0],
    [0.0, 0.0, 0.9996, 0.0, 0.0, 0.0, 0.0, 0.0276],
    [0.0026, 0.007, 0.0519, -0.0054, -0.1259, -1.5838, 9.8046, -40.7909],
    [-0.0639, 0.1723, 1.1687, 0.0, -0.2812, -13.6124, 0.0, 0.3474],
    [0.0, 0.0, 0.0006, 0.0, 0.0, 1.0, 0.0, -0.0204],
    [-0.0347, -0.0153, 0.5476, 0.0, 0.1283, -2.1328, 0.0, -1.1568],
])  # fmt: skip
# Collective, longitudinal and lateral cyclic, tail rotor, per rad.
B = np.array([
    [-0.6669, -8.0493, 3.3486, 0.0],
    [-118.0582, -31.6696, 0.0, 0.0],
    [17.7191, 46.8384, -17.9056, 0.0],
    [0.0, 0.0, 0.0, 0.0],
    [0.0658, -3.0325, -8.4263, 6.3678],
    [11.3877, -59.909, -169.7559, 7.8245],
    [0.0, 0.0, 0.0, 0.0],
    [11.8374, -11.9066, -28.5328, -19.5199],
])  # fmt: skip
ROWS = {"X": 0, "Z": 1, "M": 2, "Y": 4, "L": 5, "N": 7}
COLUMNS = {"u": 0, "w": 1, "q": 2, "v": 4, "p": 5, "r": 7}
STICKS = {"col": (0, TRAVEL), "lon": (1, TRAVEL), "lat": (2, -TRAVEL), "ped": (3, TRAVEL)}

NOISE = dict(zip(SixDof.outputs, (0.05, 0.05, 0.1, 0.003, 0.003, 0.003, 0.003, 0.003), strict=True))
AMPLITUDE = {"col": 0.04, "lat": 0.04, "lon": 0.04, "ped": 0.05}  # of full travel
# Stick per rad/s or rad of an output: what keeps the aircraft near its trim.
FEEDBACK = {("lat", "p"): 0.05, ("lat", "phi"): 0.15, ("lon", "q"): 0.2, ("lon", "theta"): 0.25,
            ("ped", "r"): -0.2}  # fmt: skip


def truth() -> SixDof:
    """The published derivatives as a parameter set."""
    values = {}
    for row, i in ROWS.items():
        for column, j in COLUMNS.items():
            values[row + column] = A[i, j]
        for stick, (j, factor) in STICKS.items():
            values[row + stick] = B[i, j] * factor
    values["Zq"] -= U0  # the derivatives contain no trim terms
    values["Yr"] += U0
    delays = dict.fromkeys(("tau_col", "tau_lat", "tau_lon", "tau_ped"), DELAY)
    return SixDof(U0=U0, **{name: float(value) for name, value in values.items()}, **delays)


def structure() -> SixDof:
    """The structure with the guesses of its file."""
    return SixDof(U0=U0)


BOUNDS = {"Lp": (-40.0, 0.0), "Llat": (0.0, 100.0)}  # a hingeless rotor is stiffer than the file's


def records(seed: int, *, dt: float = 0.02, duration: float = 30.0) -> list[Record]:
    """One 3-2-1-1 per control and sign, flown in closed loop, with noise of that seed."""
    rng = np.random.default_rng(seed)
    return [record.with_noise(NOISE, rng) for record in clean_records(dt=dt, duration=duration)]


def clean_records(*, dt: float = 0.02, duration: float = 30.0) -> list[Record]:
    """The same manoeuvres without noise."""
    return [_fly(stick, sign, dt, duration) for stick in SixDof.inputs for sign in (1.0, -1.0)]


def feedback() -> np.ndarray:
    """Sticks per output, (4, 8)."""
    gain = np.zeros((4, 8))
    for (name, output), value in FEEDBACK.items():
        gain[SixDof.inputs.index(name), SixDof.outputs.index(output)] = value
    return gain


def reference(stick: str, sign: float, dt: float, N: int) -> np.ndarray:
    """What the pilot wants of the sticks, (N, 4): a 3-2-1-1 on one of them."""
    t = dt * np.arange(N)
    step = 1.0 if stick == "col" else 0.7  # s
    edges = 2.0 + step * np.array([0, 3, 5, 6, 7])
    level = np.array([1.0, -1.0, 1.0, -1.0])
    wanted = np.zeros((N, 4))
    for a, b, value in zip(edges[:-1], edges[1:], level, strict=True):
        inside = (t >= a) & (t < b)
        wanted[inside, SixDof.inputs.index(stick)] = sign * value * AMPLITUDE[stick]
    return wanted


def _fly(stick: str, sign: float, dt: float, duration: float) -> Record:
    system = truth().system()
    plant = StateSpace(system.A, system.B, system.C, system.D)
    N, late, gain = round(duration / dt) + 1, round(DELAY / dt), feedback()
    wanted = reference(stick, sign, dt, N)
    Ad, B0, B1 = foh_step(plant.A, plant.B, dt)
    lag = np.exp(-dt / 0.06)
    x, u = np.zeros(8), np.zeros((N + 1, 4))
    y = np.empty((N, 8))
    for k in range(N):
        now, after = u[max(k - late, 0)], u[max(k + 1 - late, 0)]
        y[k] = plant.C @ x + plant.D @ now
        u[k + 1] = lag * u[k] + (1 - lag) * (wanted[k] - gain @ y[k])
        x = Ad @ x + B0 @ now + B1 @ after
    name = f"3211_{stick}{'+-'[sign < 0]}"
    return Record(dt * np.arange(N), u[:N], y, SixDof.inputs, SixDof.outputs, name)
