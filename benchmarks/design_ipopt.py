"""Switching times by IPOPT against L-BFGS, which `design_inputs` has: what it gains and costs.

    python -m benchmarks.design_ipopt

Steps of 6 s for the short-period structure, seven parameters, one stick, limits of stick, rate and
both outputs. The programme has levels and switching times as variables, the derivatives of outputs
by parameters as matrices times the stick, every limit at every sample as a constraint, and exact
first and second derivatives from CasADi; it begins where L-BFGS has ended. Where it ends is made as
small as the limits ask for before it is judged. Values are half the logarithm of the mean squared
standard error, so 0.1 less are errors 10 % smaller; seconds are processor time.
"""

import time
from dataclasses import replace

import casadi as ca
import numpy as np

from benchmarks.tables import table
from casid import DesignSettings, Limits
from casid.design.optimise import improved
from casid.design.problem import problem_of
from casid.design.shapes import Steps
from casid.nlp import Problem, SolverOptions, solve
from models.short_period import ShortPeriod

H, N, STEP, EDGE = 0.1, 61, 0.5, 0.3
LIMITS = Limits(sticks={"lon": 0.1}, rates={"lon": 1.0}, responses={"q": 0.05, "az": 1.0})
SETTINGS = DesignSettings(dt=H, rest=1.0, band=(1.0, 8.0))


class Watched(Steps):
    """Steps that keep the numbers they were asked for last."""

    def signal(self, x):
        self.last = x.copy()
        return super().signal(x)


def descended(seed):
    """Task, shape, its numbers as L-BFGS leaves them, their value, processor time [s]."""
    problem = problem_of(
        ShortPeriod(), LIMITS, H * (N - 1), None, {"az": 0.1, "q": 0.003}, SETTINGS
    )
    task, rng = problem.task(H), np.random.default_rng(seed)
    shape = Watched(H * np.arange(N), rest=1.0, step=STEP, edge=EDGE, size=0.1, rng=rng)
    first = task.information(task.within(shape.signal(shape.start)[:, None]))[0]
    task = replace(task, goals=problem.goals([np.sqrt(np.diag(np.linalg.inv(first)))]))
    begin = time.process_time()
    value = task.value(improved(task, [shape], SETTINGS.iterations))
    seconds, x = time.process_time() - begin, shape.last
    x[: shape.n] /= task.peaks(shape.signal(x)[:, None]).max()
    return task, shape, x, value, seconds


def programme(task, shape, x0):
    """Half the logarithm of the mean squared error, within limits at every sample."""
    loop, scale = task.loops[0], task.goals[0].reference
    S = np.stack([loop.sensitivities(loop.fly(row[:, None]).z) for row in np.eye(N)]) * scale
    bounded = np.flatnonzero(np.isfinite(task.limits))
    rows = task.rows([(0, k, i) for i in bounded for k in range(N)])[:, :, 0]
    x, n, nf = ca.MX.sym("x", len(x0)), shape.n, len(scale)
    jumps = ca.vertcat(x[:n], 0) - ca.vertcat(0, x[:n])
    grid, moved = shape.times(0 * x0), shape.times(1 + 0 * x0)
    begins = ca.DM(grid) + ca.DM(moved - grid) * x[n:]
    late = ca.repmat(ca.DM(H * np.arange(N)), 1, n + 1) - ca.repmat(begins.T, N, 1)
    s = ca.fmin(ca.fmax(late / EDGE, 0), 1)
    u = 0.1 * ca.mtimes(s * s * (3 - 2 * s), jumps)
    J = ca.horzcat(*(ca.mtimes(ca.DM(S[:, :, k].T), u) for k in range(nf)))
    F = ca.SX.sym("F", nf, nf)
    half = ca.solve(ca.chol(F).T, ca.SX.eye(nf))  # tr F⁻¹ is the sum of its squares
    value = ca.Function("value", [F], [0.5 * ca.log(ca.sumsqr(half) / nf)])
    ones = np.ones(len(rows))
    return Problem(
        x=x, f=value(ca.mtimes(J.T, J)), g=ca.mtimes(ca.DM(rows), u), x0=x0, lower_x=shape.lower,
        upper_x=shape.upper, lower_g=-ones, upper_g=ones,
    )  # fmt: skip


def main():
    rows = []
    for seed in range(3):
        task, shape, x, value, seconds = descended(seed)
        begin = time.process_time()
        found = solve(programme(task, shape, x), SolverOptions(tolerance=1e-6), stage="steps").x
        r = shape.signal(np.ravel(found))[:, None]
        took, peak = time.process_time() - begin, float(task.peaks(r).max())
        rows.append([seed, value, seconds, task.value(task.within(r)), took, peak])
    header = ["seed", "L-BFGS", "seconds", "IPOPT", "seconds", "share of a limit where it ends"]
    print(table(header, rows))


if __name__ == "__main__":
    main()
