"""What designed inputs are worth on the AH-1S: standard errors over those of four 3-2-1-1.

    python -m benchmarks.design [CASE ...] [--kept FILE]

Six degrees of freedom, 64 parameters, at the quasi-steady linearisation. Compared with are the
sticks of the four 3-2-1-1 without feedback that come with the example, 20 s each, each record with
its own initial states and biases. The designs last 64 s, the sticks within the largest deviation of
those records and, where responses are limited, every output and velocity within 1.5 times its
largest there, as far as the models drawn from the prior say. Nor are sticks faster than the edges
of those records, from end to end within a sample. Each case is kept in FILE when it is done; the
seconds are processor time. A number behind `free`, `limited`, `equal`, `narrow` and `flown` is the
seed of the square wave that the optimisation starts from, 0 without.

`limited` has the usual margin, for 20 %, `narrow` one for 10 %; `equal` is `limited` as long as the
four 3-2-1-1 together and with the criterion that weighs the largest errors (MV), of which the
optimisation has twice the iterations. A `wrong prior` has every derivative wrong by 30 %, up or
down at random; the design is judged by the truth. `margin` is designed for the same priors with a
margin for these 30 %, `ensemble` for four models besides, each 30 % away from it. `identified` has
as prior what output error makes of the example's four 3-2-1-1 in the loop, with noise. `quarter` is
held against the four 3-2-1-1 and the four sweeps together and lasts a quarter of their time. All
but `free`, `limited`, `equal`, `narrow` and `quarter` are designed with the loop of the example's
closed-loop records and flown in the nonlinear simulation of JSBSim (`ah1s.py`): peaks and sticks
are those of that simulation, the share of the sticks' power from outside is the lower bound of the
certificate of excitation.

`--nonlinear` has a nonlinear structure as truth, `RigidBody` with the same derivatives, flies
3-2-1-1 and design in it and identifies both. `--monte-carlo RUNS` flies a design for the
lateral-directional structure with feedback RUNS times with new noise and compares the scatter of
output error with the standard errors that were predicted; `--monte-carlo RUNS six` does so with
`SixDof`. In both the feedback hears the noise, too; of the share from outside the certificate's
lower bound is held against the one that is known, by a flight of the same design without noise.
`--seed` is that of the design's start and of the noise.
"""

import argparse
import json
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import interp1d
from scipy.signal import welch

from benchmarks.tables import against, cell, table
from casid import DesignSettings, Limits, Record, design_inputs, output_error, read_csv
from casid.design.criterion import covariance
from casid.design.loop import Loop, gains
from casid.excitations import excitation
from casid.free import free_parameters
from models.lateral_directional import LateralDirectional
from models.rigid_body import RigidBody
from models.six_dof import SixDof

NOISE = {"ax": 0.05, "ay": 0.05, "az": 0.1} | dict.fromkeys(SixDof.outputs[3:], 0.003)
R = np.diag([NOISE[name] ** 2 for name in SixDof.outputs])
DT, LENGTH, TIMES, FINE = 0.04, 64.0, 1.5, 0.01
# Of the example's records, u = r - K y: fractions of travel per rad/s and rad.
FEEDBACK = {"lat": {"p": 0.2, "phi": 0.4}, "lon": {"q": -0.4, "theta": -0.5}, "ped": {"r": -0.3}}
CASES = (
    "limited", "equal", "equal 1", "equal 2", "equal 3", "equal 7", "free", "free 1", "free 2",
    "quarter", "narrow", "narrow 1", "narrow 2", "flown", "flown 1", "flown 2", "identified",
    *(f"wrong prior {k}" for k in (1, 2, 3, 7)), "margin 1", "ensemble 1",
)  # fmt: skip
LINEAR = ("free", "limited", "equal", "narrow", "quarter")  # cases that are not flown in JSBSim
SPREADS = {"narrow": 0.1, "margin": 0.3, "ensemble": 0.3}  # margins; of the others the usual one
WANTED = {"free": (0.27, 0.34), "quarter": (1.0, np.inf),  # of the others 0.4 and 0.6
          "margin": (np.inf, np.inf), "ensemble": (np.inf, np.inf)}  # fmt: skip
WRONG = ("wrong prior", "margin", "ensemble")
SHRUNK = 0.75  # share of the gain that is left with a wrong prior, at least


def truth():
    """The structure at the linearisation of the simulation."""
    content = json.loads(Path("examples/ah1s/ah1s_jsbsim_080kt.json").read_text())
    A, B = np.array(content["A"]), np.array(content["B"])[:, [0, 2, 1, 3]]  # stored col, lon, lat
    model = SixDof(U0=41.13, V0=0.035, W0=-1.412, phi0=-0.0251, theta0=-0.0343)
    names = [name for name in model.parameter_names() if not name.startswith("tau")]
    bare = replace(model, **dict.fromkeys(names, 0.0)).system()
    values = {}
    for i, force in enumerate("XYZLMN"):
        for j, state in enumerate(SixDof.states[:6]):
            values[f"{force}{state}"] = float(A[i, j] - bare.A[i, j])
        for j, stick in enumerate(SixDof.inputs):
            values[f"{force}{stick}"] = float(B[i, j])
    return replace(model, **values)


def flown(kind):
    """Records of the example that were flown without feedback, or its sweeps; outputs and u v w."""
    channels = {"inputs": SixDof.inputs, "outputs": (*SixDof.outputs, "u", "v", "w")}
    files = [f"examples/ah1s/data/{kind.format(stick)}.csv" for stick in SixDof.inputs]
    return [read_csv(file, detrend="first", **channels).decimate(2) for file in files]


def errors_of(model, records, feedback=None):
    """Standard errors that the sticks of records, flown in that loop, buy together."""
    F = 0.0
    for record in records:
        loop = Loop(free_parameters(model), feedback or {}, R, h=record.dt, N=record.N)
        J = loop.sensitivities(loop.held(record.u))
        F = F + J.T @ J
    return np.sqrt(np.diag(covariance(F)))


def peaks(records):
    """Largest deviation of each channel in any record."""
    return {
        name: max(float(np.abs(record.channel(name)).max()) for record in records)
        for name in (*records[0].inputs, *records[0].outputs)
    }


def rates(records):
    """Largest rate of each stick in any record."""
    return {
        n: max(float(np.abs(np.diff(r.channel(n))).max() / r.dt) for r in records)
        for n in records[0].inputs
    }


def limits(tops, fastest, responses):
    """The largest deviations and rates of the records, deviations of responses times 1.5."""
    sides = {n: TIMES * x for n, x in tops.items() if n not in SixDof.inputs}
    sticks = {n: tops[n] for n in SixDof.inputs}
    return Limits(sticks=sticks, rates=fastest, responses=sides if responses else {})


def moved(model, seed, by=0.3):
    """The model with every derivative wrong by 30 %, up or down."""
    rng = np.random.default_rng(seed)
    names = model.parameter_names()
    signs = np.array([0.0 if n.startswith("tau") else rng.choice([-by, by]) for n in names])
    return model.with_vector(model.vector() * (1 + signs))


def prior(case, model):
    """What is believed before the flight, and other models that are thought possible."""
    kind, _, number = case.rpartition(" ")
    if kind in WRONG:
        wrong = moved(model, int(number))
        others = [moved(wrong, 20 * int(number) + k) for k in range(1, 5)]
        return wrong, others if kind == "ensemble" else ()
    if case != "identified":
        return model, ()
    rng = np.random.default_rng(9)
    noisy = [r.select(SixDof.inputs, SixDof.outputs).with_noise(NOISE, rng)
             for r in flown("3211_{}")]  # fmt: skip
    return output_error(model, noisy, interval=1.0), ()


def run(case):
    """Ratios of a case."""
    model, four = truth(), flown("3211_{}_open")
    bought, tops, fastest, length = errors_of(model, four), peaks(four), rates(four), LENGTH
    if case == "quarter":
        sweeps = flown("sweep_{}")
        bought = errors_of(model, [*four, *sweeps])
        length = sum(r.duration for r in (*four, *sweeps)) / 4
    if case.startswith("equal"):
        length = sum(r.duration for r in four)
    kind, _, number = case.rpartition(" ")
    feedback = {} if case.startswith(LINEAR) else FEEDBACK
    believed, ensemble = prior(case, model)
    settings = DesignSettings(
        method="steps", dt=DT,
        **({"criterion": "MV", "iterations": 300} if case.startswith("equal") else {}),
        seed=int(number) if kind and kind not in WRONG else 0, spread=SPREADS.get(kind or case),
    )  # fmt: skip
    begin = time.process_time()
    made = design_inputs(
        believed, limits(tops, fastest, not case.startswith("free")), length, noise=NOISE,
        feedback=feedback, ensemble=ensemble, settings=settings,
    )  # fmt: skip
    seconds = time.process_time() - begin
    record = simulated(made) if feedback else linear(model, made)
    ratio = errors_of(model, [record]) / bought
    seen, fast = peaks([record]), rates([record])
    shares = [max(seen[n] / tops[n] for n in names) for names in (SixDof.inputs, SixDof.outputs)]
    return {
        "case": case, "length": length, "mean": float(np.exp(np.log(ratio).mean())),
        "worst": float(ratio.max()), "of": made.names[int(np.argmax(ratio))],
        "sticks": shares[0], "rates": max(fast[n] / fastest[n] for n in fastest),
        "responses": shares[1], "seconds": seconds,
        "share": share_from_outside(record) if feedback else 1.0,
        "others": others(made, model, tops) if case == "flown" else None,
    }  # fmt: skip


def others(made, model, tops):
    """How many of 40 aircraft 30 % off the prior keep the limits of outputs, and the worst."""
    limit, found = TIMES * np.array([tops[n] for n in SixDof.outputs]), []
    for seed in range(100, 140):
        free = free_parameters(moved(model, seed))
        loop = Loop(free, FEEDBACK, R, h=2 * DT, N=(len(made.t) + 1) // 2)
        found.append(float((np.abs(loop.fly(made.r[::2]).y).max(axis=0) / limit).max()))
    return [sum(share <= 1 for share in found), max(found)]


def share_from_outside(record):
    """Least share, by its lower bound, of a stick's power that does not come from the outputs."""
    noisy = record.with_noise({n: NOISE[n] for n in record.outputs}, np.random.default_rng(3))
    share = excitation(noisy)
    return float(share.lower[share.within].min())


def heard(made, feedback, seed):
    """A design less what its feedback makes of noise, (N, nu), and that noise (N, ny)."""
    std = [NOISE[name] for name in made.outputs]
    noise = std * np.random.default_rng(seed).standard_normal(made.y.shape)
    return made.r - noise @ gains(feedback, made.inputs, made.outputs).T, noise


def shares_told(noisy, quiet):
    """Least share from outside: by the certificate, and as the flight without noise knows it."""
    share = excitation(noisy)
    omega, outside = welch(quiet.u, 2 * np.pi / DT, nperseg=256, axis=0)
    back = welch(noisy.u - quiet.u, 2 * np.pi / DT, nperseg=256, axis=0)[1]
    known = interp1d(omega, outside / (outside + back), axis=0)(share.omega)
    least = [float(each[share.within].min()) for each in (share.lower, known)]
    return f"least share from outside {against(least[0], 0.5, above=True)}, known {least[1]:.3f}"


def linear(model, made):
    """What the true linear model makes of a design without feedback."""
    return replace(made.record(), y=model.system().simulate(made.t, made.u))


def simulated(made):
    """What JSBSim makes of a design in its loop."""
    from ah1s import Helicopter  # noqa: PLC0415 - only these cases need JSBSim

    return Helicopter().fly(made.t, made.r, made.inputs, FEEDBACK).decimate(2)


def rigid(t, r, inputs, model, feedback):
    """Record, in total values, of a nonlinear structure in its loop: Runge-Kutta, delays exact."""
    (x, u0), f, lam = model.operating_point(), model.equations(), model.vector()
    rate = lambda x, u: f(x, u, lam)[0].full().ravel()  # noqa: E731
    seen = lambda x, u: f(x, u, lam)[1].full().ravel()  # noqa: E731
    K, late = gains(feedback, inputs, model.outputs), round(model.tau_lat / FINE)
    y0, u, y, d = seen(x, u0), [], [], [u0] * (late + 1)
    for now in FINE * np.arange(round(t[-1] / FINE) + 1):
        y.append(seen(x, d[-late]))
        u.append(u0 + [np.interp(now, t, column) for column in r.T] - K @ (y[-1] - y0))
        d.append(u[-1])
        this, after = d[-late - 1], d[-late]
        k1 = rate(x, this)
        k2 = rate(x + FINE / 2 * k1, (this + after) / 2)
        k3 = rate(x + FINE / 2 * k2, (this + after) / 2)
        x = x + FINE / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + FINE * k3, after))
    each = slice(None, None, round(DT / FINE))
    u, y = np.array(u)[each], np.array(y)[each]
    return Record(DT * np.arange(len(u)), u, y, inputs, model.outputs)


def nonlinear(seed):
    """A nonlinear structure flown in its loop and identified, against its four 3-2-1-1."""
    linear = truth()
    model = RigidBody(**{each.name: getattr(linear, each.name) for each in fields(linear)})
    trims = tuple(name for name in model.parameter_names() if name.endswith("trim"))
    held = (*trims, *(name for name in model.parameter_names() if name.startswith("tau")))
    four = [rigid(r.t, r.u, SixDof.inputs, model, {}) for r in flown("3211_{}_open")]
    y0 = four[0].y[0]
    tops = dict(zip(SixDof.outputs, np.max([np.abs(r.y - y0).max(axis=0) for r in four], 0),
                    strict=True))  # fmt: skip
    sticks = dict(zip(SixDof.inputs, np.max([np.abs(r.u).max(axis=0) for r in four], 0),
                      strict=True))  # fmt: skip
    made = design_inputs(
        model, limits({**sticks, **tops}, rates(four), True), LENGTH, noise=NOISE,
        feedback=FEEDBACK,
        settings=DesignSettings(method="steps", dt=DT, fixed=held, seed=seed),
    )  # fmt: skip
    quiet = rigid(made.t, made.r, made.inputs, model, FEEDBACK)
    r, noise = heard(made, FEEDBACK, [11, seed])
    alone = [rigid(made.t, r, made.inputs, model, FEEDBACK)]
    rng = np.random.default_rng([12, seed])
    noisy = [[record.with_noise(NOISE, rng) for record in four],
             [replace(alone[0], y=alone[0].y + noise)]]  # fmt: skip
    fits = [output_error(model, each, R=R, fixed=held, interval=2.0) for each in noisy]
    errors = [np.array([fit[name].cramer_rao for name in made.names]) for fit in fits]
    ratio = errors[1] / errors[0]
    true = np.array([getattr(model, name) for name in made.names])
    value = np.array([[fit[name].value for name in made.names] for fit in fits])
    off = np.sqrt(np.mean(((value - true) / errors) ** 2, axis=1))
    peak = float((np.abs(alone[0].y - y0).max(axis=0) / list(tops.values())).max())
    stick = float((np.abs(alone[0].u).max(axis=0) / list(sticks.values())).max())
    print(
        f"RigidBody, {len(ratio)} parameters, identified: standard errors over those of four "
        f"3-2-1-1 {against(np.exp(np.log(ratio).mean()), 0.4)}, worst {against(ratio.max(), 0.6)}; "
        f"responses {against(peak, TIMES)}, sticks {stick:.3g}; predicted over identified "
        f"{np.exp(np.log(made.std_errors / errors[1]).mean()):.3g}; estimates off the truth by "
        f"{off[0]:.3g} and {off[1]:.3g} standard errors (rms); {shares_told(noisy[1][0], quiet)}"
    )


def monte_carlo(runs, six, seed):
    """Scatter over predicted standard errors of a design that is flown with new noise each time."""
    tops = peaks(flown("3211_{}_open"))
    model = truth() if six else LateralDirectional(U0=41.13)
    feedback = FEEDBACK if six else {"lat": {"p": 0.05, "phi": 0.1}}
    allowed = Limits(sticks=dict.fromkeys(model.inputs, 0.05), responses={"phi": 0.3})
    if six:
        allowed = limits(tops, rates(flown("3211_{}_open")), True)
    noise = {name: NOISE[name] for name in model.outputs}
    covariances = np.diag([std**2 for std in noise.values()])
    made = design_inputs(
        model, allowed, LENGTH if six else 20.0, noise=noise, feedback=feedback,
        settings=DesignSettings(method="steps", dt=DT, seed=seed),
    )  # fmt: skip
    loop = Loop(free_parameters(model), feedback, covariances, h=DT, N=len(made.t))
    found, true = [], [getattr(model, name) for name in made.names]
    for run in range(runs):
        r, e = heard(made, feedback, [7, seed, run])
        quiet = replace(made.record(), u=loop.fly(r).u)
        noisy = replace(quiet, y=model.system().simulate(made.t, quiet.u) + e)
        fit = output_error(model, noisy, R=covariances, interval=2.0)
        found.append([fit[name].value for name in made.names])
    ratio = np.std(found, axis=0, ddof=1) / made.std_errors
    size, k = float(np.sqrt(np.mean(ratio**2))), int(np.argmax(np.abs(np.log(ratio))))
    off = float(np.sqrt(np.mean((np.mean(found, axis=0) - true) ** 2 / made.std_errors**2)))
    print(
        f"{type(model).__name__}, {len(ratio)} parameters, {runs} runs: scatter over prediction "
        f"{size:.3f} (rms), away from 1 by {against(abs(size - 1), 0.15)}; furthest {ratio[k]:.3f} "
        f"of {made.names[k]}, a standard error of each {(2 * runs - 2) ** -0.5:.3f}; mean off the "
        f"truth by {off:.2f} predicted errors, {runs**-0.5:.2f} expected; "
        f"{shares_told(noisy, made.record())}"
    )


def wanted(case, done):
    """Largest geometric mean and worst ratio."""
    if not case.startswith("wrong"):
        return WANTED.get(case.split()[0], (0.4, 0.6))
    return round(done.get("flown", {"mean": 0.4})["mean"] / SHRUNK, 3), np.inf


def judge(cases, kept):
    """Run the cases that FILE does not have yet; one table of all."""
    lines = kept.read_text().splitlines() if kept.exists() else []
    done = {row["case"]: row for row in map(json.loads, lines)}
    for case in cases:
        if case not in done:
            done[case] = run(case)
            kept.parent.mkdir(parents=True, exist_ok=True)
            with kept.open("a") as file:
                file.write(json.dumps(done[case]) + "\n")
    header = ["case", "flown [s]", "geometric mean", "worst", "of",
              "sticks over those of 3-2-1-1", "their rates", "responses",
              "least share from outside", "seconds"]  # fmt: skip
    rows = []
    for case in cases:
        row = done[case]
        two = zip([row["mean"], row["worst"]], wanted(case, done), strict=True)
        peak = (
            cell(row["responses"]) if case.startswith("free") else against(row["responses"], TIMES)
        )
        told = [against(x, limit) if limit < np.inf else cell(x) for x, limit in two]
        share = against(row["share"], 0.5, above=True)
        tail = [row["sticks"], row["rates"], peak, share, row["seconds"]]
        rows.append([case, row["length"], *told, row["of"], *tail])
    print(table(header, rows))
    if told := done.get("flown", {}).get("others"):
        print(
            f"of 40 aircraft 30 % away {told[0]} keep the limits, the worst reaches {told[1]:.3g}"
        )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", default=CASES)
    parser.add_argument("--kept", type=Path, default=Path("out/design.jsonl"))
    parser.add_argument("--nonlinear", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="RUNS")
    options = parser.parse_args()
    if options.nonlinear:
        nonlinear(options.seed)
    elif options.monte_carlo:
        monte_carlo(options.monte_carlo, options.cases == ["six"], options.seed)
    else:
        judge(options.cases, options.kept)


if __name__ == "__main__":
    main()
