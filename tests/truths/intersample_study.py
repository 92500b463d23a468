"""An unstable helicopter flown in closed loop through brute force, estimated many times."""

import numpy as np
from scipy.linalg import expm

from casid import Record, output_error
from truths.brute_force import PARTS
from truths.closed_roll import Roll

H = 0.04  # s
SIGMA = np.array([0.05, 0.005, 0.005])  # m/s^2, rad/s, rad; of v in place of ay m/s
X0, BIAS = np.array([0.3, -0.02, 0.01]), np.array([0.1, 0.01, -0.02])
BOUNDS = {"tau": (0.0, 0.5)}


class Smooth(Roll):
    """The same, its first output without direct term: lateral velocity."""

    outputs = ("v", "p", "phi")

    def C(self):
        return [[1, 0, 0], [0, 1, 0], [0, 0, 1]]

    def D(self):
        return [[0, 0], [0, 0], [0, 0]]


def fine_map(system):
    """Step of a part of a sample from (state, input, its rate)."""
    nx, nu = system.B.shape
    M = np.zeros((nx + 2 * nu, nx + 2 * nu))
    M[:nx, :nx], M[:nx, nx : nx + nu], M[nx : nx + nu, nx + nu :] = system.A, system.B, np.eye(nu)
    return expm(M * H / PARTS)[:nx]


def flight(model, hold, delay, rng, N=300):
    """One record: sharp random steps of both sticks, bank and rate fed back as measured.

    The lateral stick is heard ``delay`` samples late; the loop is integrated on a grid that holds
    the delay. Every edge of a stick is one sample wide.
    """
    plant, late = model.system(), round(delay * PARTS)
    E, x, felt, keep = fine_map(plant), X0, 0.0, np.exp(-H / 0.1)
    levels = rng.choice([-0.1, 0.0, 0.1], size=(N // 15 + 2, 2)).repeat(15, axis=0)[:N]
    levels[:25] = 0.0
    u, y = np.zeros((N + 1, 2)), np.empty((N, 3))
    fine = np.zeros(((N + 1) * PARTS + 1, 2))  # the sticks as flown, at every part's begin
    for k in range(N):
        heard = max(k * PARTS - late, 0)
        now = fine[[heard, k * PARTS], [0, 1]]
        y[k] = plant.C @ x + plant.D @ now + BIAS + SIGMA * rng.standard_normal(3)
        felt = keep * felt + (1 - keep) * (0.03 * y[k, 2] + 0.01 * y[k, 1])
        u[k + 1] = levels[min(k + 1, N - 1)] - [felt, 0.0]
        share = np.arange(PARTS + 1)[:, None] / PARTS * (hold == "foh")
        fine[k * PARTS : (k + 1) * PARTS + 1] = u[k] + share * (u[k + 1] - u[k])
        for part in range(k * PARTS, (k + 1) * PARTS):
            first = max(part - late, 0)
            begin = np.array([fine[first, 0], fine[part, 1]])
            rate = (hold == "foh") * np.array(
                [(fine[first + 1, 0] - begin[0]) * (part >= late), fine[part + 1, 1] - begin[1]]
            )
            x = E @ np.concatenate([x, begin, rate * PARTS / H])
        fine[(k + 1) * PARTS] = u[k + 1]
    t = H * np.arange(N)
    return Record(t, u[:N], y, model.inputs, model.outputs, hold=hold)


def estimate(hold, direct, delay, run, records=2):
    """(fit, truth) of a run; a delay at a whole number of samples is held."""
    truth = (Roll if direct else Smooth)(tau=delay * H)
    rng = np.random.default_rng([16, run, round(100 * delay), direct, hold == "foh"])
    flown = [flight(truth, hold, delay, rng) for _ in range(records)]
    fixed = ("tau",) if delay == int(delay) else ()
    return output_error(truth, flown, fixed=fixed, bounds=BOUNDS), truth


def campaign_run(hold, direct, delay, run):
    """Errors of the free parameters, their bounds of Cramér and Rao, and the standard errors."""
    fit, truth = estimate(hold, direct, delay, run)
    rows = [row for row in fit.parameters if row.name in fit.free_names]
    errors = [row.value - getattr(truth, row.name) for row in rows]
    return errors, [row.cramer_rao for row in rows], [row.std_error for row in rows]
