"""Filter error in turbulence: error against the Cramér-Rao bound, by nothing of casid but the fit.

Truths of two, four and eight states, two to eight outputs, unstable and flown in closed loop by the
noisy instruments; white noise drives the states, sampled exactly by Van Loan's exponential. The
bound is that of a Kalman filter written here, differentiated by differences, initial states,
biases and all variances unknown too.

    OMP_NUM_THREADS=1 python -m benchmarks.turbulence [N] [--case NAME] [--first SEED]
                                                      [--samples 1000]

N runs each (30), their seeds from the first (0) on.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from benchmarks import bo105
from benchmarks.tables import cell, table
from casid import ConvergenceError, Model, Record, Rows, Scalar, output_error, parameter
from models.lateral_directional import LateralDirectional

H = 0.04  # s


class Bank(Model):
    """Roll rate and bank of an unstable rotorcraft: 0.42 and -1.92 1/s."""

    states = ("p", "phi")
    inputs = ("lat",)
    outputs = ("p", "phi")

    Lphi: Scalar = parameter(default=0.8, unit="1/s^2")
    Lp: Scalar = parameter(default=-1.5, unit="1/s")
    Llat: Scalar = parameter(default=6.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Lp, self.Lphi], [1, 0]]

    def B(self) -> Rows:
        return [[self.Llat], [0]]


@dataclass(frozen=True)
class Case:
    """A truth, its noises and how it is flown."""

    truth: Model
    density: np.ndarray  # (nx,) of the process noises [state²/s]
    sigma: np.ndarray  # (ny,) of the measurement noise
    gain: np.ndarray  # (nu, ny) feedback to the sticks
    amplitude: float  # of the pilot's steps
    records: int
    N: int
    start: Callable[[Model], Model]  # where the estimate begins


def nearly(model: Model) -> Model:
    """Everything a fifth off, zeros and delays apart."""
    fields = {name: 1.2 * getattr(model, name) for name in model.parameter_names()
              if not name.startswith("tau")}  # fmt: skip
    return replace(model, **fields)


def cases() -> dict[str, Case]:
    lateral = LateralDirectional(tau_lat=0.0, tau_ped=0.0)
    six = replace(bo105.truth(), **dict.fromkeys(("tau_col", "tau_lat", "tau_lon", "tau_ped"), 0.0))
    return {
        "2 states, 2 outputs": Case(
            Bank(), np.array([0.3, 0.0]) ** 2, np.array([0.02, 0.01]), np.array([[0.15, 0.5]]),
            0.1, 1, 1000, nearly,
        ),
        "4 states, 4 outputs": Case(
            lateral, np.array([0.5, 0.05, 0.03, 0.0]) ** 2, np.array([0.1, 0.005, 0.005, 0.005]),
            np.array([[0.0, 0.05, 0.0, 0.1], [0.0, 0.0, 0.1, 0.0]]), 0.05, 2, 1000, nearly,
        ),
        "8 states, 8 outputs": Case(
            six, np.array([0.4, 0.4, 0.4, 0.05, 0.03, 0.03, 0.0, 0.0]) ** 2,
            np.array(list(bo105.NOISE.values())), bo105.feedback(), 0.03, 4, 1000, nearly,
        ),
    }  # fmt: skip


def sampled(model: Model, density: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A_d, the inputs' [B_0, B_1] for straight lines, and Q_d of the noise, over one step."""
    system = model.system()
    (nx, nu), (A, B) = system.B.shape, (system.A, system.B)
    M = np.zeros((nx + 2 * nu, nx + 2 * nu))
    M[:nx, :nx], M[:nx, nx : nx + nu], M[nx : nx + nu, nx + nu :] = A * H, B * H, np.eye(nu)
    E = scipy.linalg.expm(M)[:nx]
    held, ramp = E[:, nx : nx + nu], E[:, nx + nu :]
    loan = np.block([[-A, np.diag(density)], [np.zeros((nx, nx)), A.T]]) * H
    V = scipy.linalg.expm(loan)
    Ad = V[nx:, nx:].T
    return Ad, np.hstack([held - ramp, ramp]), Ad @ V[:nx, nx:]


def fly(case: Case, rng: np.random.Generator, name: str) -> Record:
    """One record: random steps of the sticks, a pilot flying by the noisy instruments."""
    system = case.truth.system()
    Ad, B01, Qd = sampled(case.truth, case.density)
    root = np.linalg.cholesky(Qd + 1e-14 * np.trace(Qd) * np.eye(len(Qd)))
    steps = case.amplitude * rng.choice([-1, 0, 1], size=(case.N // 12 + 1, system.nu))
    wanted = np.repeat(steps, 12, axis=0)[: case.N]
    x, u, y = np.zeros(system.nx), np.zeros((case.N + 1, system.nu)), np.zeros((case.N, system.ny))
    keep = np.exp(-H / 0.06)
    for k in range(case.N):
        y[k] = system.C @ x + system.D @ u[k] + case.sigma * rng.standard_normal(system.ny)
        u[k + 1] = keep * u[k] + (1 - keep) * (wanted[k] - case.gain @ y[k])
        x = Ad @ x + B01 @ np.concatenate(u[k : k + 2]) + root @ rng.standard_normal(system.nx)
    t, truth = H * np.arange(case.N), case.truth
    return Record(t, u[: case.N], y, truth.inputs, truth.outputs, name)


def innovations(case, record, theta, x0, bias):
    """Innovations and covariances of a Kalman filter; theta: λ, log Q, log R.

    It has run for two seconds when the record begins.
    """
    n, nx = len(case.truth.vector()), len(case.density)
    model = case.truth.with_vector(theta[:n])
    system = model.system()
    Ad, B01, Qd = sampled(model, np.exp(theta[n : n + nx]))
    R, C = np.diag(np.exp(theta[n + nx :])), system.C
    ahead = np.hstack([record.u, np.vstack([record.u[1:], record.u[-1:]])]) @ B01.T
    measured = record.y - record.u @ system.D.T - bias
    P, x, e, S = np.zeros((nx, nx)), x0, np.empty_like(record.y), []
    for k in range(-round(2 / H), record.N):
        if len(S) < 300 or not np.allclose(S[-1], S[-2], rtol=1e-12, atol=0):
            S.append(C @ P @ C.T + R)
            K = np.linalg.solve(S[-1], C @ P @ Ad.T).T
            P = Ad @ P @ Ad.T - K @ S[-1] @ K.T + Qd
        else:
            S.append(S[-1])
        if k < 0:
            continue
        e[k] = measured[k] - C @ x
        x = Ad @ x + ahead[k] + K @ e[k]
    return e, np.array(S[-record.N :])


def information(case, records):
    """Fisher information of λ (n, n), all else eliminated."""
    density = np.maximum(case.density, 1e-12)
    theta = np.concatenate([case.truth.vector(), np.log(density), 2 * np.log(case.sigma)])
    n = len(case.truth.vector())
    noises = n + np.flatnonzero(np.concatenate([case.density > 0, case.sigma > 0]))
    moving = np.concatenate([free_places(case.truth), noises])
    (nx, ny), m = (len(case.density), len(case.sigma)), len(moving)
    F = np.zeros((m + (nx + ny) * len(records),) * 2)
    for r, record in enumerate(records):
        rows, spread = [], []
        _, S = innovations(case, record, theta, np.zeros(nx), np.zeros(ny))
        unit = np.concatenate([np.maximum(np.abs(theta[moving]), 0.1), np.ones(nx + ny)])
        for i in range(m + nx + ny):
            both = []
            for sign in (1, -1):
                at, x0, bias = theta.copy(), np.zeros(nx), np.zeros(ny)
                step = sign * 1e-5 * unit[i]
                if i < m:
                    at[moving[i]] += step
                else:
                    (x0 if i < m + nx else bias)[(i - m) % nx if i < m + nx else i - m - nx] += step
                both.append(innovations(case, record, at, x0, bias))
            rows.append((both[0][0] - both[1][0]) / (2e-5 * unit[i]))
            spread.append((both[0][1] - both[1][1]) / (2e-5 * unit[i]))
        W = np.linalg.inv(np.linalg.cholesky(S))
        J = np.einsum("kab,ikb->ika", W, rows).reshape(len(rows), -1)
        V = np.einsum("kab,ikbc,kdc->ikad", W, spread, W, optimize=True).reshape(len(rows), -1)
        index = np.concatenate([np.arange(m), m + (nx + ny) * r + np.arange(nx + ny)])
        F[np.ix_(index, index)] += J @ J.T + V @ V.T / 2
    return F


def bound(case, records):
    """Cramér-Rao bound of λ, (n,)."""
    F = information(case, records)
    unit = 1 / np.sqrt(np.diag(F))
    covariance = np.linalg.inv(F * np.outer(unit, unit)) * np.outer(unit, unit)
    return np.sqrt(np.diag(covariance))[: len(free_places(case.truth))]


def free_places(truth):
    """Places of the parameters that are estimated: all but delays."""
    return [i for i, name in enumerate(truth.parameter_names()) if not name.startswith("tau")]


def run(case, seed):
    """(errors, standard errors, converged, iterations) of a run."""
    rng = np.random.default_rng([33, seed, len(case.density)])
    records = [fly(case, rng, f"flight {i}") for i in range(case.records)]
    names = case.truth.parameter_names()
    free = [names[i] for i in free_places(case.truth)]
    held, bounds = set(names) - set(free), dict.fromkeys(free, (-1e4, 1e4))
    start = case.start(case.truth)
    try:
        fit = output_error(start, records, process_noise=True, fixed=held, bounds=bounds)
    except ConvergenceError as error:
        fit = error.best
        print(fit.status, file=sys.stderr)
    rows = [row for row in fit.parameters if row.name in fit.free_names]
    errors = [row.value - getattr(case.truth, row.name) for row in rows]
    return errors, [row.std_error for row in rows], fit, records


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=30)
    parser.add_argument("--case", default="")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--samples", type=int, default=1000, help="of a record")
    chosen, rows = parser.parse_args(), []
    for name, usual in cases().items():
        if chosen.case not in name:
            continue
        case, found = replace(usual, N=chosen.samples), []
        for seed in range(chosen.first, chosen.first + chosen.runs):
            found.append(run(case, seed))
            print(name, seed, found[-1][2].iterations, found[-1][2].success,
                  f"{found[-1][2].seconds:.1f}", file=sys.stderr, flush=True)  # fmt: skip
        errors, std = (np.array([each[i] for each in found]) for i in range(2))
        least = bound(case, found[0][3])
        ratio = np.sqrt(np.mean(errors**2, axis=0)) / least
        rows.append((
            name, f"{sum(each[2].success for each in found)} of {chosen.runs}", ratio.mean(),
            np.abs(errors.mean(axis=0) / least).max(),
            100 * np.mean(np.abs(errors) < 1.96 * std),
        ))  # fmt: skip
        print(*map(cell, rows[-1]), file=sys.stderr, flush=True)
    print(table(("truth", "converged", "RMSE / Cramér-Rao, mean", "largest mean error, σ",
                 "95 % intervals cover, %"), rows))  # fmt: skip


if __name__ == "__main__":
    main()
