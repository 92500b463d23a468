"""Output error of nonlinear structures: casid against the textbook programme, and against a truth.

    OMP_NUM_THREADS=1 python -m benchmarks.nonlinear [--all]     RigidBody on the UH-60's records
    OMP_NUM_THREADS=1 python -m benchmarks.nonlinear monte-carlo [N]
    OMP_NUM_THREADS=1 python -m benchmarks.nonlinear jumps [N] [--seed S]

The textbook writes a Runge-Kutta step as a CasADi function, accumulates it over an interval, maps
that over all intervals, lets `casadi.jacobian` differentiate the residuals and gives IPOPT the
Gauss-Newton Hessian JᵀJ. Both sides have the same records, 66 parameters (delays held), intervals,
steps, R, start, scaling, tolerance and linear solver; times are processor time of this one process.
With ``--all`` the textbook solves all eight records too, else the four 3-2-1-1.

The first Monte Carlo flies a pendulum through ±1 rad, where the sine is far from its tangent. In
the second the thrust of a rotor goes by the square of a command that jumps between 0 and 1, as a
brake does between levels; both delays are free and between samples, and SciPy solves the equations
from jump to jump.
"""

import argparse
import time
from dataclasses import fields, replace

import casadi as ca
import numpy as np

from benchmarks.output_error import R_TRUE, noisy_records, start_of
from benchmarks.tables import table
from casid import ConvergenceError, NonlinearModel, Record, SolverOptions, output_error
from casid.free import free_parameters
from casid.nlp import Problem, solve
from casid.shooting.frequency import IPOPT
from casid.shooting.intervals import lay_out
from casid.shooting.newton import Newton
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.programme import Programme
from casid.shooting.sensitivity import whiteners
from casid.shooting.starting import starting_programme
from models.rigid_body import RigidBody

TAUS = ("tau_col", "tau_lat", "tau_lon", "tau_ped")
INTERVAL = 2.0  # s


def rigid_body(records: list[Record]) -> RigidBody:
    """The structure in total values, from the quadratic match of its linear twin."""
    linear, trim = start_of(records), records[0].trim
    names = {f"{name}0": trim[name] for name in RigidBody.inputs}
    names |= {each.name: getattr(linear, each.name) for each in fields(linear)}
    return RigidBody(**names)


def textbook(programme: Programme, start: np.ndarray) -> Problem:
    """The same problem as the programme's, from expressions."""
    e, s = programme.evaluator, programme.scales
    M, J = int(e.layout.count[0]), programme.J
    step, data = one_step(programme)
    x, b = ca.MX.sym("x", e.nx), ca.MX.sym("b", e.ny)
    lam, d = ca.MX.sym("lam", e.nf), ca.MX.sym("d", len(data), M)
    states, R = step.mapaccum(M)(x, ca.repmat(lam, 1, M), ca.repmat(b, 1, M), d)
    interval = ca.Function("interval", [x, lam, b, d], [states[:, -1], R])
    w, nb = ca.MX.sym("w", programme.size), programme.records * e.ny
    bias = ca.reshape(w[e.nf : e.nf + nb], e.ny, -1) * s.bias
    nodes = ca.reshape(w[e.nf + nb :], e.nx, J) * s.state
    every = ca.repmat(w[: e.nf] * s.lam, 1, J)
    ends, R = interval.map(J)(nodes, every, bias[:, programme.record.tolist()], ca.DM(data))
    R = ca.vec(R) / np.sqrt(programme.n)
    links = programme.links.tolist()
    gaps = ca.vec((ends[:, links] - nodes[:, [j + 1 for j in links]]) / s.state)
    Jr = ca.jacobian(R, w)
    p, lam_f, lam_g = ca.MX.sym("p", 0), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", gaps.numel())
    hessian = ca.Function(
        "nlp_hess_l", [w, p, lam_f, lam_g], [ca.triu(lam_f * ca.mtimes(Jr.T, Jr))]
    )
    like = Newton(programme).problem(start)
    return replace(like, x=w, f=ca.dot(R, R) / 2, g=gaps, hessian=hessian, functions={})


def one_step(programme: Programme) -> tuple[ca.Function, np.ndarray]:
    """(x, λ, bias, data) -> (x+, whitened residual) of one sample, and all samples' data."""
    e, layout = programme.evaluator, programme.evaluator.layout
    m = e.matrices(programme.free.guess)
    stages = e.stages(m).u.reshape(len(layout.y), -1)  # no cuts: inputs add to the forces
    u = np.concatenate([part.value for part in e.held(m)])
    data = np.hstack([stages, e.lengths[:, None] / e.substeps, u, layout.y]).T
    x, lam, b = ca.SX.sym("x", e.nx), ca.SX.sym("lam", e.nf), ca.SX.sym("b", e.ny)
    seen = [ca.SX.sym("u", e.nu) for _ in range(3 * e.substeps)]
    h, now, y = ca.SX.sym("h"), ca.SX.sym("now", e.nu), ca.SX.sym("y", e.ny)
    equations, full = programme.free.model.equations(), programme.free.full(lam)
    after = x
    for first, middle, last in zip(*(seen[i::3] for i in range(3)), strict=True):
        k1 = equations(after, first, full)[0]
        k2 = equations(after + h / 2 * k1, middle, full)[0]
        k3 = equations(after + h / 2 * k2, middle, full)[0]
        k4 = equations(after + h * k3, last, full)[0]
        after = after + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    W = ca.DM(whiteners(programme.noise.given, layout)[0])
    r = W @ (equations(x, now, full)[1] + b - y)
    return ca.Function("step", [x, lam, b, ca.vertcat(*seen, h, now, y)], [after, r]), data


def timed_casid(model: RigidBody, records: list[Record], options: SolverOptions):
    begin = time.process_time()
    free = free_parameters(model, fixed=TAUS)
    evaluator = NonlinearEvaluator(free, lay_out([r.total() for r in records], INTERVAL))
    programme, point = starting_programme(evaluator, free, R_TRUE, biases=True)
    start = programme.pack(point)
    newton = Newton(programme)
    solution = solve(newton.problem(start), options, stage="casid")
    return programme, start, solution, time.process_time() - begin


def race(everything: bool) -> None:
    """Processor time of both, and how far apart their estimates are."""
    records = noisy_records()
    model, options, rows = rigid_body(records), SolverOptions(ipopt=IPOPT), []
    for chosen in (records[:4], records):
        programme, start, ours, seconds = timed_casid(model, chosen, options)
        row = [f"{sum(r.N for r in chosen)}", f"{programme.evaluator.nf}", seconds, ours.iterations]
        if everything or len(chosen) == 4:
            begin = time.process_time()
            theirs = solve(textbook(programme, start), options, stage="textbook")
            spent = time.process_time() - begin
            x, y = (programme.unpack(each.x[: programme.size]).lam for each in (ours, theirs))
            apart = np.max(np.abs(x - y) / np.maximum(np.abs(y), programme.scales.lam))
            row += [spent, theirs.iterations, spent / seconds, f"{apart:.1e}"]
        rows.append((*row, *["-"] * (8 - len(row))))
        print(table(("samples", "parameters", "casid, s", "iterations", "textbook, s",
                     "iterations", "ratio", "estimates apart"), rows), flush=True)  # fmt: skip


def swings(runs: int) -> None:
    """At large amplitude."""
    from tests.truths.swing import TRUTH, Swing, swung  # noqa: PLC0415 - a truth of the tests

    clean = swung(0, noise=0.0, duration=20.0)
    noise = dict.fromkeys(("q", "theta"), 0.05)
    monte_carlo(Swing(), TRUTH.vector(), clean, noise, [[7, run] for run in range(runs)])


def jumps(runs: int, seed: int) -> None:
    """Inputs that jump between samples, through a square."""
    from tests.truths.thrust import Squared, flown  # noqa: PLC0415 - a truth of the tests

    dt = 0.02
    truth = np.array([9.0, 0.3, 5.0, 2.65 * dt, 1.4 * dt])
    clean = flown(Squared, truth, "zoh", n=800, dt=dt, seed=seed)
    monte_carlo(Squared(), truth, clean, {"w": 0.05, "n": 0.03}, [[seed, i] for i in range(runs)])


def monte_carlo(
    model: NonlinearModel,
    truth: np.ndarray,
    clean: Record,
    noise: dict[str, float],
    seeds: list[list[int]],
) -> None:
    """Error over bound and coverage of 95 % intervals; what the steps would still move."""
    errors, plain, robust, shifts, failed = [], [], [], [], 0
    for seed in seeds:
        try:
            fit = output_error(model, clean.with_noise(noise, np.random.default_rng(seed)))
        except ConvergenceError:
            failed += 1
            continue
        errors.append(fit.model.vector() - truth)
        plain.append([row.cramer_rao for row in fit.parameters])
        robust.append([row.std_error for row in fit.parameters])
        shifts.append(fit.notes.integration.shift)
    e, bound, std = map(np.array, (errors, plain, robust))
    ratio = np.sqrt(np.mean(e**2, axis=0) / np.mean(bound**2, axis=0))
    covered = [100 * np.mean(np.abs(e) < 1.96 * each, axis=0) for each in (bound, std)]
    print(table(("parameter", "RMSE / Cramér-Rao", "covered, %", "by corrected intervals, %"),
                list(zip(model.parameter_names(), ratio, *covered, strict=True))))  # fmt: skip
    print(
        f"{len(seeds)} runs, {failed} failed, all: {np.sqrt(np.mean(ratio**2)):.3f}, "
        f"{covered[0].mean():.1f} %; halving the steps moves {max(shifts):.1e} σ at most"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="?", default="race", choices=["race", "monte-carlo", "jumps"])
    parser.add_argument("runs", nargs="?", type=int, default=200)
    parser.add_argument("--all", action="store_true", help="the textbook on all records")
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    if chosen.what == "race":
        race(chosen.all)
    elif chosen.what == "jumps":
        jumps(chosen.runs, chosen.seed)
    else:
        swings(chosen.runs)


if __name__ == "__main__":
    main()
