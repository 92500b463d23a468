"""Real flights of a quadrotor: the example's structure against other programs' black boxes.

    python -m benchmarks.crazyflie [--method N4SID ...] [--order 2 ...]

All see the same five flights at 50 Hz (the others as one record, means removed, channels scaled)
and are simulated and predicted over the same two that none has seen, by `validate`, as if inputs
ahead were prescribed and as answers of a controller that keeps outputs bounded (`closed_loop`);
predictions of the others also from the state of their own gains. Persistence is the last sample
held. The structure is also given its inputs at the 100 Hz of the logs, as a continuous one may be,
and compared at the same instants.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import peers
from casid import StateSpace, output_error, read_study, validate
from casid.goodness_of_fit import fit_percent
from casid.prediction import prediction_plan
from casid.studies.study import read_records

STUDY = Path(__file__).resolve().parents[1] / "examples/crazyflie/study.toml"
OUTPUTS = ("p", "q", "phi", "theta")
HORIZONS = (np.inf, 1.0, 0.1)
METHODS = ("N4SID", "CVA", "PARSIM-K")


def foreign(records, methods, orders):
    """Models of the other programs by name, and their gains."""
    first = records[0]
    u, y = (np.vstack([getattr(each, letter) for each in records]) for letter in "uy")
    su, sy = u.std(axis=0), y.std(axis=0)
    found = peers.identify(u / su, y / sy, orders, horizon=15, feedthrough=False, dt=first.dt,
                           methods=methods)  # fmt: skip
    return {
        f"{method} {order}": (
            StateSpace(
                each.system.A, each.system.B / su, each.system.C * sy[:, None],
                each.system.D * sy[:, None] / su, first.dt, first.inputs, first.outputs
            ),
            each.K / sy,
        )
        for (method, order), each in found.items()
    }  # fmt: skip


def ahead(record, state, plan):
    """Pieces of a record predicted from each start by ``state(start, end)`` (n, outputs)."""
    y = np.full((record.N, len(OUTPUTS)), np.nan)
    starts = plan.starts
    for start, end in zip(starts, (*starts[1:], record.N - 1), strict=True):
        y[start + 1 : end + 1] = state(start, end)
    measured = record.y[:, [record.outputs.index(name) for name in OUTPUTS]]
    there = np.isfinite(y[:, 0])
    return [fit_percent(a, b) for a, b in zip(measured[there].T, y[there].T, strict=True)]


def by_gain(system, K, record, plan):
    """Predictions from the states that a model's own gain gives."""
    u = record.u[:, [record.inputs.index(name) for name in system.inputs]]
    y = record.y[:, [record.outputs.index(name) for name in system.outputs]]
    x = np.zeros((record.N, system.nx))
    for k in range(record.N - 1):
        x[k + 1] = system.A @ x[k] + system.B @ u[k] + K @ (y[k] - system.C @ x[k])
    rows = [system.outputs.index(name) for name in OUTPUTS]

    def predicted(start, end):
        found = [x[start + 1]]
        for k in range(start + 1, end):
            found.append(system.A @ found[-1] + system.B @ u[k])
        return np.array(found) @ system.C[rows].T

    return ahead(record, predicted, plan)


def baselines(own, gains, records, horizon):
    """Fits [%] of the others by their own gains, and of the last sample held."""
    columns = [records[0].outputs.index(name) for name in OUTPUTS]
    looks = [
        prediction_plan([system for system, _ in gains.values()] + [own], r, horizon)
        for r in records
    ]
    rows = {
        f"{name}, its own gain": [by_gain(*each, r, o) for r, o in zip(records, looks, strict=True)]
        for name, each in gains.items()
    }
    rows["persistence"] = [
        ahead(r, lambda start, end, r=r: np.tile(r.y[start, columns], (end - start, 1)), o)
        for r, o in zip(records, looks, strict=True)
    ]
    return rows


def table(own, gains, flights, horizon):
    """Fit [%] of each model on each unseen flight; the best of the others an output."""
    records = [each.decimate(2) for each in flights]
    models = {"Multirotor": own} | {name: system for name, (system, _) in gains.items()}
    rows = {}
    for closed_loop in (False, True)[: 1 + np.isfinite(horizon)]:
        found = validate(models, records, horizon=horizon, closed_loop=closed_loop)
        columns = [found.outputs.index(each) for each in OUTPUTS]
        said = ", closed loop" * closed_loop
        rows |= {name + said: found.fit[name][:, columns] for name in models}
    if np.isfinite(horizon):
        rows |= baselines(own, gains, records, horizon)
    odd = np.arange(max(each.N for each in flights)) % 2 == 1
    fine = [replace(r, y=np.where(odd[: r.N, None], np.nan, r.y)) for r in flights]
    found = validate({"Multirotor": own}, fine, horizon=horizon, closed_loop=closed_loop)
    rows[f"Multirotor{said}, inputs at 100 Hz"] = found.fit["Multirotor"][:, columns]
    print(f"\npredicted {horizon:g} s ahead" if np.isfinite(horizon) else "\nsimulated whole")
    print("|  |" + "".join(f" {each.name}: {', '.join(OUTPUTS)} |" for each in records))
    others = [row for name, row in rows.items() if name.startswith(METHODS)]
    rows["best of the others"] = np.nanmax(others, axis=0)
    for name, row in rows.items():
        cells = (" " + ", ".join(f"{x:.0f}" for x in each) + " |" for each in row)
        print(f"| {name} |" + "".join(cells))


def one_by_one(study, records):
    """What each flight says of the parameters on its own."""
    print("| flight | " + " | ".join(type(study.model).infos()) + " |")
    for record in records:
        fit = output_error(study.model, record, interval=1.0)
        cells = (f"{row.value:.3g} ± {row.std_error:.2g}" for row in fit.parameters)
        print(f"| {record.name} | " + " | ".join(cells) + " |")


def main(methods, orders):
    study = read_study(STUDY)
    roles = read_records(study)
    one_by_one(study, [*roles["identification"], *roles["validation"]])
    fit = output_error(study.model, roles["identification"], interval=1.0)
    chosen = {
        role: [
            each.select(("roll", "pitch", "yaw"), ("p", "q", "r", "phi", "theta")).decimate(2)
            for record in roles[role]
            for each in record.resample(0.01).stretches()
        ]
        for role in ("identification", "validation")
    }
    gains = foreign(chosen["identification"], methods, orders)
    flights = [record.resample(0.01) for record in roles["validation"]]
    for horizon in HORIZONS:
        table(fit.model.system(), gains, flights, horizon)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", nargs="+", default=METHODS)
    parser.add_argument("--order", nargs="+", type=int, default=range(2, 17))
    asked = parser.parse_args()
    main(asked.method, asked.order)
