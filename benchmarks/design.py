"""What designed inputs are worth on the AH-1S: standard errors over those of four 3-2-1-1.

    PYTHONPATH=. python benchmarks/design.py [CASE ...] [--kept FILE]

Six degrees of freedom, 64 parameters, at the quasi-steady linearisation. Compared with are the
sticks of the four 3-2-1-1 without feedback that come with the example, 20 s each, each record with
its own initial states and biases. The designs last 64 s, the sticks within the largest deviation of
those records and, where responses are limited, every output and velocity within 1.5 times its
largest there, as far as the models drawn from the prior say. Each case is kept in FILE when it is
done; the seconds are processor time.

A `wrong prior` has every derivative wrong by 30 %, up or down at random; the design is judged by
the truth. `quarter` is held against the four 3-2-1-1 and the four sweeps together and lasts a
quarter of their time. `flown` and `flown, wrong prior` are designed with the loop of the example's
closed-loop records and flown in the nonlinear simulation of JSBSim (`ah1s.py`): peaks and sticks
are those of that simulation. `--monte-carlo RUNS` flies a design for the lateral-directional
structure with feedback RUNS times with new noise and compares the scatter of output error with the
standard errors that were predicted.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from tables import against, cell, table

from casid import DesignSettings, Limits, design_inputs, output_error, read_csv
from casid.design.criterion import covariance
from casid.design.loop import Loop
from casid.excitations import excitation
from casid.model import free_parameters
from models.lateral_directional import LateralDirectional
from models.six_dof import SixDof

NOISE = {"ax": 0.05, "ay": 0.05, "az": 0.1} | dict.fromkeys(SixDof.outputs[3:], 0.003)
R = np.diag([NOISE[name] ** 2 for name in SixDof.outputs])
DT, LENGTH, TIMES = 0.04, 64.0, 1.5
# Of the example's records, u = r - K y: fractions of travel per rad/s and rad.
FEEDBACK = {"lat": {"p": 0.2, "phi": 0.4}, "lon": {"q": -0.4, "theta": -0.5}, "ped": {"r": -0.3}}
CASES = ("free", "limited", "quarter", "wrong prior", "flown", "flown, wrong prior")
WANTED = {"free": (0.27, 0.34), "quarter": (1.0, np.inf)}  # of the others 0.4 and 0.6


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


def errors_of(model, records):
    """Standard errors that the sticks of records buy together."""
    F = 0.0
    for record in records:
        loop = Loop(free_parameters(model), {}, R, h=record.dt, N=record.N)
        J = loop.sensitivities(loop.held(record.u))
        F = F + J.T @ J
    return np.sqrt(np.diag(covariance(F)))


def peaks(records):
    """Largest deviation of each channel in any record."""
    return {
        name: max(float(np.abs(record.channel(name)).max()) for record in records)
        for name in (*records[0].inputs, *records[0].outputs)
    }


def limits(tops, responses):
    """The largest deviations of the records, those of responses times 1.5."""
    sides = {n: TIMES * x for n, x in tops.items() if n not in SixDof.inputs}
    return Limits(sticks={n: tops[n] for n in SixDof.inputs}, responses=sides if responses else {})


def moved(model, seed, by=0.3):
    """The model with every derivative wrong by 30 %, up or down."""
    rng = np.random.default_rng(seed)
    names = model.parameter_names()
    signs = np.array([0.0 if n.startswith("tau") else rng.choice([-by, by]) for n in names])
    return model.with_vector(model.vector() * (1 + signs))


def run(case, seed):
    """Ratios of a case."""
    model, four = truth(), flown("3211_{}_open")
    bought, tops, length = errors_of(model, four), peaks(four), LENGTH
    if case == "quarter":
        sweeps = flown("sweep_{}")
        bought = errors_of(model, [*four, *sweeps])
        length = sum(r.duration for r in (*four, *sweeps)) / 4
    believed = moved(model, 1 + 10 * seed) if "wrong prior" in case else model
    feedback = FEEDBACK if "flown" in case else {}
    begin = time.process_time()
    made = design_inputs(
        believed, limits(tops, case != "free"), length, noise=NOISE, feedback=feedback,
        settings=DesignSettings(method="steps", dt=DT, seed=seed),
    )  # fmt: skip
    seconds = time.process_time() - begin
    record = simulated(made) if feedback else linear(model, made)
    ratio = errors_of(model, [record]) / bought
    seen = peaks([record])
    shares = [max(seen[n] / tops[n] for n in names) for names in (SixDof.inputs, SixDof.outputs)]
    return {
        "case": case, "length": length, "mean": float(np.exp(np.log(ratio).mean())),
        "worst": float(ratio.max()), "of": made.names[int(np.argmax(ratio))],
        "sticks": shares[0], "responses": shares[1], "seconds": seconds,
    }  # fmt: skip


def linear(model, made):
    """What the true linear model makes of a design without feedback."""
    return replace(made.record(), y=model.system().simulate(made.t, made.u))


def simulated(made):
    """What JSBSim makes of a design in its loop."""
    from ah1s import Helicopter  # noqa: PLC0415 - only these cases need JSBSim

    return Helicopter().fly(made.t, made.r, made.inputs, FEEDBACK).decimate(2)


def monte_carlo(runs):
    """Scatter over predicted standard errors of a small design, one row a parameter."""
    model = LateralDirectional(U0=41.13)
    noise = {name: NOISE[name] for name in model.outputs}
    made = design_inputs(
        model, Limits(sticks=dict.fromkeys(model.inputs, 0.05), responses={"phi": 0.3}), 20.0,
        noise=noise, feedback={"lat": {"p": 0.05, "phi": 0.1}},
        settings=DesignSettings(method="steps", dt=DT, iterations=60),
    )  # fmt: skip
    R = np.diag([noise[name] ** 2 for name in model.outputs])
    record, found = made.record(), []
    for seed in range(runs):
        noisy = record.with_noise(noise, np.random.default_rng([7, seed]))
        fit = output_error(model, noisy, R=R)
        found.append([fit[name].value for name in made.names])
    ratio = np.std(found, axis=0, ddof=1) / made.std_errors
    mean = float(np.exp(np.log(ratio).mean()))
    near = against(abs(mean - 1), 0.15)
    print(f"scatter of {runs} runs over prediction: {mean:.3f}, away from 1 by {near}")
    share = excitation(record.with_noise(noise, np.random.default_rng(7)))
    least = float(share.lower[share.within].min())
    print(f"least share from outside, lower bound: {against(least, 0.5, above=True)}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", default=CASES)
    parser.add_argument("--kept", type=Path, default=Path("out/design.jsonl"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="RUNS")
    options = parser.parse_args()
    if options.monte_carlo:
        monte_carlo(options.monte_carlo)
        return
    lines = options.kept.read_text().splitlines() if options.kept.exists() else []
    done = {row["case"]: row for row in map(json.loads, lines)}
    for case in options.cases:
        if case not in done:
            done[case] = run(case, options.seed)
            options.kept.parent.mkdir(parents=True, exist_ok=True)
            with options.kept.open("a") as file:
                file.write(json.dumps(done[case]) + "\n")
    header = ["case", "flown [s]", "geometric mean", "worst", "of",
              "sticks over those of 3-2-1-1", "responses", "seconds"]  # fmt: skip
    rows = []
    for case in options.cases:
        row = done[case]
        two = zip([row["mean"], row["worst"]], WANTED.get(case, (0.4, 0.6)), strict=True)
        peak = cell(row["responses"]) if case == "free" else against(row["responses"], TIMES)
        told = [against(x, limit) for x, limit in two]
        rows.append([case, row["length"], *told, row["of"], row["sticks"], peak, row["seconds"]])
    print(table(header, rows))


if __name__ == "__main__":
    main()
