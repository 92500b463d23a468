"""Output error: casid against the textbook multiple-shooting programme, in one process.

The textbook writes every sample as a CasADi expression, lets `casadi.jacobian` differentiate the
residuals, and gives IPOPT the Gauss-Newton Hessian JᵀJ. Three ways to build it are timed on a part
of the records, and the fastest of them solves all: intervals unrolled sample by sample, an interval
as a function mapped over all intervals, and a mapped interval that is itself a mapped accumulation
(``mapaccum``). Both sides have the same records (eight UH-60 manoeuvres at 50 Hz), 64 parameters,
intervals, R, delay model (the straight lines delayed exactly), start, scaling, tolerance and linear
solver; the ratio is of build plus solve, in processor time of this one process (other work on the
machine moves it little). Run with one BLAS thread:

    OMP_NUM_THREADS=1 python -m benchmarks.output_error

Two more questions, of casid alone:

    python -m benchmarks.output_error growth           time and memory with records and intervals
    python -m benchmarks.output_error monte-carlo [N]  error against bound, coverage: 64 parameters
"""

import argparse
import resource
import sys
import time
from dataclasses import replace

import casadi as ca
import numpy as np

from benchmarks import bo105
from benchmarks.tables import table
from benchmarks.uh60 import DATA, INPUTS, NOISE, OUTPUTS, STEPS, SWEEPS
from casid import Model, Record, SolverOptions, match, output_error, pbsid, read_csv
from casid.free import Free, free_parameters
from casid.nlp import Problem, solve
from casid.shooting.frequency import IPOPT
from casid.shooting.intervals import Layout, lay_out
from casid.shooting.newton import Newton
from casid.shooting.programme import Programme
from casid.shooting.sensitivity import Evaluator, whiteners
from casid.shooting.starting import starting_programme
from models.six_dof import SixDof

R_TRUE = np.diag(np.array(list(NOISE.values())) ** 2)
TAYLOR = 20  # terms of the matrix exponential; |A h| < 1, so the rest is below rounding


def one_step(A: ca.MX, B: ca.MX, h: float, rest: ca.MX) -> list[ca.MX]:
    """e^{Ah} and what value, slope and a jump of the slope ``rest`` before the end do.

    By the Taylor series of the exponential and its integrals.
    """
    Ad, P1, P2 = ca.MX.eye(A.shape[0]), ca.MX.zeros(*B.shape), ca.MX.zeros(*B.shape)
    late, driven = ca.MX.zeros(*B.shape), B
    power, factor = ca.MX.eye(A.shape[0]), 1.0
    for k in range(1, TAYLOR + 1):
        factor /= k
        P1 += driven * (factor * h**k)
        P2 += driven * (factor * h ** (k + 1) / (k + 1))
        late += driven * ca.repmat((rest ** (k + 1) * (factor / (k + 1))).T, A.shape[0], 1)
        power, driven = ca.mtimes(power, A), ca.mtimes(A, driven)
        Ad += power * (factor * h**k)
    return [Ad, P1, P2, late]


def sample_function(W: np.ndarray, nx: int, nu: int, ny: int) -> ca.Function:
    """(x, step, out, bias, inputs, y) -> (x+, whitened residual) of one sample."""
    x, u = ca.MX.sym("x", nx), ca.MX.sym("u", 3 * nu)
    b, y = ca.MX.sym("b", ny), ca.MX.sym("y", ny)
    step, out = ca.MX.sym("step", nx, nx + 3 * nu), ca.MX.sym("out", ny, nx + nu)
    after = ca.mtimes(step, ca.vertcat(x, u))
    r = ca.mtimes(ca.DM(W), ca.mtimes(out, ca.vertcat(x, u[:nu])) + b - y)
    return ca.Function("sample", [x, step, out, b, u, y], [after, r]).expand()


def residuals(
    build: str, sample: ca.Function, M: int, nodes: ca.MX, step: ca.MX, out: ca.MX,
    bias: ca.MX, u: ca.MX, y: ca.DM,
) -> tuple[ca.MX, ca.MX]:  # fmt: skip
    """Residuals of all samples and end states of all intervals, built in one of three ways."""
    J = nodes.shape[1]
    if build == "unrolled":
        ends, rows = [], []
        for j in range(J):
            x = nodes[:, j]
            for k in range(j * M, (j + 1) * M):
                x, r = sample(x, step, out, bias[:, j], u[:, k], y[:, k])
                rows.append(r)
            ends.append(x)
        return ca.vertcat(*rows), ca.horzcat(*ends)
    nx, nu, ny = nodes.shape[0], u.shape[0], y.shape[0]
    x, b = ca.MX.sym("x", nx), ca.MX.sym("b", ny)
    P, Q = ca.MX.sym("P", *step.shape), ca.MX.sym("Q", *out.shape)
    U, Y = ca.MX.sym("U", nu, M), ca.MX.sym("Y", ny, M)
    if build == "mapaccum":
        states, R = sample.mapaccum(M)(
            x, ca.repmat(P, 1, M), ca.repmat(Q, 1, M), ca.repmat(b, 1, M), U, Y
        )
        end = states[:, -1]
    else:
        end, parts = x, []
        for k in range(M):
            end, r = sample(end, P, Q, b, U[:, k], Y[:, k])
            parts.append(r)
        R = ca.horzcat(*parts)
    interval = ca.Function("interval", [x, P, Q, b, U, Y], [end, R])
    ends, R = interval.map(J)(nodes, ca.repmat(step, 1, J), ca.repmat(out, 1, J), bias, u, y)
    return ca.vec(R), ends


def longest_delay(free: Free) -> float:
    upper = np.where(np.isfinite(free.upper), free.upper, 0)
    return float(np.max(free.model.matrices()(upper)[4].full()))


def delayed_inputs(layout: Layout, tau: ca.MX, longest: float, h: float) -> ca.MX:
    """Value, slope and its jump of the delayed inputs of all samples, (3 nu, N)."""
    count = int(np.floor(longest / h)) + 4
    number = ca.DM(list(range(-1, count - 1)))
    records = []
    for record in layout.records:
        u = np.vstack([np.repeat(record.u[:1], count, axis=0), record.u, record.u[-1:]])
        k = np.arange(count, count + record.N)
        parts: list[list[ca.MX]] = [[], [], []]
        for j in range(record.nu):
            taps = ca.DM(np.stack([u[k - i, j] for i in range(-1, count - 1)], axis=1))
            m = ca.floor(tau[j] / h)
            before, at, after = (number == m - 1, number == m, number == m + 1)
            parts[0].append(ca.mtimes(taps, ca.fmax(0, 1 - ca.fabs(number - tau[j] / h))).T)
            parts[1].append(ca.mtimes(taps, at - after).T / h)
            parts[2].append(ca.mtimes(taps, before - 2 * at + after).T / h)
        records.append(ca.vertcat(*(row for part in parts for row in part)))
    return ca.horzcat(*records)


def textbook(programme: Programme, start: np.ndarray, build: str) -> Problem:
    """The same problem as the programme's, from expressions."""
    e, s, free = programme.evaluator, programme.scales, programme.free
    layout, (nx, nu, ny) = e.layout, (e.nx, e.nu, e.ny)
    M, J = int(layout.count[0]), programme.J
    if not (layout.count == M).all() or len(layout.classes) > 1:
        raise ValueError("the textbook here needs intervals of one length and one spacing")
    (h,) = layout.classes
    w = ca.MX.sym("w", programme.size)
    nf, nb = e.nf, programme.records * ny
    lam = w[:nf] * s.lam
    bias = ca.reshape(w[nf : nf + nb], ny, -1) * s.bias
    nodes = ca.reshape(w[nf + nb :], nx, J) * s.state
    matrices = free.model.matrices()
    A, B, C, D, tau, c = matrices(free.full(lam))
    rest = (ca.floor(tau / h) + 1) * h - tau
    step, out = ca.horzcat(*one_step(A, B, h, rest)), ca.horzcat(C, D)
    u = delayed_inputs(layout, tau, longest_delay(free), h)
    W = whiteners(programme.noise.given, layout)[0]
    R, ends = residuals(
        build, sample_function(W, nx, nu, ny), M, nodes, step, out,
        bias[:, programme.record.tolist()], u, ca.DM(layout.y.T),
    )  # fmt: skip
    R = R / np.sqrt(programme.n)
    links = programme.links.tolist()
    gaps = (ends[:, links] - nodes[:, [j + 1 for j in links]]) / s.state
    Jr = ca.jacobian(R, w)
    f = ca.dot(R, R) / 2
    p, lam_f, lam_g = ca.MX.sym("p", 0), ca.MX.sym("lam_f"), ca.MX.sym("lam_g", gaps.numel())
    hessian = ca.Function(
        "nlp_hess_l", [w, p, lam_f, lam_g], [ca.triu(lam_f * ca.mtimes(Jr.T, Jr))]
    )
    like = Newton(programme).problem(start)
    return replace(like, x=w, f=f, g=ca.vertcat(ca.vec(gaps), c), hessian=hessian, functions={})


def timed_textbook(programme, start, options, build):
    begin = time.process_time()
    problem = textbook(programme, start, build)
    built = time.process_time() - begin
    solution = solve(problem, options, stage=f"textbook, {build}")
    return solution, built, time.process_time() - begin


def timed_casid(model, records, R, interval, options):
    begin = time.process_time()
    evaluator = Evaluator(free_parameters(model), lay_out(records, interval))
    programme, point = starting_programme(evaluator, free_parameters(model), R, biases=True)
    start = programme.pack(point)
    newton = Newton(programme)
    problem = newton.problem(start)
    built = time.process_time() - begin
    solution = solve(problem, options, stage="casid")
    return programme, start, solution, built, time.process_time() - begin


def compare(model: Model, records: list[Record], R, interval, options, builds):
    """Rows of (name, seconds to build, seconds in all, solution)."""
    programme, start, ours, built, total = timed_casid(model, records, R, interval, options)
    constant = programme.noise.cost(R, np.zeros((1, len(R), len(R)))) / programme.n  # log det R
    rows = [("casid", built, total, replace(ours, f=ours.f - constant))]
    for build in builds:
        solution, built, total = timed_textbook(programme, start, options, build)
        rows.append((build, built, total, solution))
    for name, built, total, solution in rows:
        print(f"  {name:10s} build {built:7.2f} s   build and solve {total:8.2f} s   "
              f"{solution.iterations} iterations   cost {solution.f:.12g}   {solution.status}",
              flush=True)  # fmt: skip
    return programme, rows


def noisy_records(seed: int = 20130) -> list[Record]:
    """The eight records, sticks as fractions of full travel, the last sample left out."""
    rng = np.random.default_rng(seed)
    percent = dict.fromkeys(INPUTS, "%")
    return [
        read_csv(DATA / f"{name}.csv", inputs=INPUTS, outputs=OUTPUTS, units=percent,
                 detrend="first").between(0.0, end).with_noise(NOISE, rng)
        for names, end in ((STEPS, 15.99), (SWEEPS, 69.99)) for name in names
    ]  # fmt: skip


def start_of(records: list[Record]) -> Model:
    """What the chain hands to output error: black box, then the quadratic match."""
    trim = {"U0": 40.922, "V0": 2.811, "W0": 2.054, "P0": -0.0002, "Q0": -0.0001, "R0": 0.0057,
            "phi0": 0.0213, "theta0": 0.0531}  # fmt: skip
    black_box = pbsid(records, order=16, feedthrough=["ax", "ay", "az"])
    return match(SixDof(**trim), black_box, norm="quadratic").model


# ---- growth -------------------------------------------------------------------------------------


def measure_growth() -> None:
    """Build and solve with more records, and with longer intervals; resident memory so far."""
    options = SolverOptions(ipopt=IPOPT)
    model, rows = start_of(noisy_records()), []
    for copies, interval in ((1, 2.0), (2, 2.0), (4, 2.0), (1, 1.0), (1, 5.0), (1, 10.0)):
        records = [record for seed in range(copies) for record in noisy_records(20130 + seed)]
        programme, _, solution, _, total = timed_casid(model, records, R_TRUE, interval, options)
        samples = sum(record.N for record in records)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append((f"{samples}", interval, f"{programme.J}", total, f"{solution.iterations}",
                     1e6 * total / solution.iterations / samples, f"{peak:.0f}"))  # fmt: skip
        print(rows[-1], file=sys.stderr, flush=True)
    print(table(("samples", "interval, s", "intervals", "s", "iterations",
                 "µs per sample and iteration", "peak memory so far, MB"), rows))  # fmt: skip


# ---- Monte Carlo --------------------------------------------------------------------------------


def bo105_estimates(runs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors (runs, 64) of the Bo105's parameters, and their Cramér-Rao bounds and standard errors.

    The structure is the truth's, flown in closed loop; noise is white and new in every run. Bounds
    are out of reach, since a bound would do better than the bound of Cramér and Rao.
    """
    truth = bo105.truth()
    clean = bo105.clean_records(dt=0.04, duration=20.0)
    bounds = {name: (-1e3, 1e3) for name in truth.parameter_names() if name[:3] != "tau"}
    found = np.empty((3, runs, len(truth.vector())))
    for run in range(runs):
        rng = np.random.default_rng([105, run])
        records = [record.with_noise(bo105.NOISE, rng) for record in clean]
        fit = output_error(truth, records, interval=1.0, bounds=bounds)
        found[0, run] = fit.model.vector() - truth.vector()
        found[1, run] = [row.cramer_rao for row in fit.parameters]
        found[2, run] = [row.std_error for row in fit.parameters]
    return found[0], found[1], found[2]


def monte_carlo(runs: int) -> None:
    """Error over bound and coverage of 95 % intervals, over all parameters."""
    errors, plain, corrected = bo105_estimates(runs)
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.mean(plain**2, axis=0))
    covered = [100 * np.mean(np.abs(errors) < 1.96 * std) for std in (plain, corrected)]
    names = bo105.truth().parameter_names()
    low, high = (names[int(pick(ratio))] for pick in (np.argmin, np.argmax))
    print(table(
        ("runs", "RMSE / Cramér-Rao, mean", "least", "largest", "covered, %",
         "covered by corrected intervals, %"),
        [(f"{runs}", ratio.mean(), f"{ratio.min():.3g} ({low})", f"{ratio.max():.3g} ({high})",
          *covered)],
    ))  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="?", default="textbook",
                        choices=["textbook", "growth", "monte-carlo"])  # fmt: skip
    parser.add_argument("runs", nargs="?", type=int, default=100)
    parser.add_argument("--interval", type=float, default=2.0, help="shooting interval [s]")
    parser.add_argument("--build", choices=["unrolled", "map", "mapaccum"], help="skip the trial")
    chosen = parser.parse_args()
    if chosen.what == "growth":
        measure_growth()
    elif chosen.what == "monte-carlo":
        monte_carlo(chosen.runs)
    else:
        race(chosen.interval, chosen.build)


def race(interval: float, build: str | None) -> None:
    """casid against the fastest textbook programme."""
    R = R_TRUE
    records = noisy_records()
    model = start_of(records)
    options = SolverOptions(ipopt=IPOPT)

    builds = [build] if build else ["unrolled", "map", "mapaccum"]
    if len(builds) > 1:
        print("the four 3-2-1-1 records:")
        _, rows = compare(model, records[:4], R, interval, options, builds)
        builds = [min(rows[1:], key=lambda row: row[2])[0]]
    print(f"all eight records, {sum(r.N for r in records)} samples:")
    programme, (ours, theirs) = compare(model, records, R, interval, options, builds)
    x, y = (programme.unpack(row[3].x).lam for row in (ours, theirs))
    apart = np.max(np.abs(x - y) / np.maximum(np.abs(y), programme.scales.lam))
    print(f"estimates agree to {apart:.1e}, costs to {abs(ours[3].f / theirs[3].f - 1):.1e}")
    print(f"build and solve: {theirs[2] / ours[2]:.1f} x")


if __name__ == "__main__":
    main()
