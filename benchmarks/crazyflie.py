"""Real flights of a quadrotor: the example's structure against other programs' black boxes.

    PYTHONPATH=. python benchmarks/crazyflie.py [--method N4SID ...] [--order 2 ...]

All see the same five flights at 50 Hz (the others as one record, means removed, channels scaled)
and are simulated and predicted over the same two that none has seen, by `validate`.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks import peers
from casid import StateSpace, output_error, read_study, validate
from casid.studies.study import read_records

STUDY = Path(__file__).resolve().parents[1] / "examples/crazyflie/study.toml"
OUTPUTS = ("p", "q", "phi", "theta")
HORIZONS = (np.inf, 1.0, 0.1)


def foreign(records, methods, orders):
    """Models of the other programs by name."""
    first = records[0]
    u, y = (np.vstack([getattr(each, letter) for each in records]) for letter in "uy")
    su, sy = u.std(axis=0), y.std(axis=0)
    found = peers.identify(u / su, y / sy, orders, horizon=15, feedthrough=False, dt=first.dt,
                           methods=methods)  # fmt: skip
    return {
        f"{method} {order}": StateSpace(
            each.system.A, each.system.B / su, each.system.C * sy[:, None],
            each.system.D * sy[:, None] / su, first.dt, first.inputs, first.outputs
        )
        for (method, order), each in found.items()
    }  # fmt: skip


def table(models, records, horizon):
    """Fit [%] of each model on each unseen flight; the best of the others a channel."""
    rows = {}
    for name, model in models.items():
        found = validate({name: model}, records, horizon=horizon)
        rows[name] = found.fit[name][:, [found.outputs.index(each) for each in OUTPUTS]]
    print(f"\npredicted {horizon:g} s ahead" if np.isfinite(horizon) else "\nsimulated whole")
    print("|  |" + "".join(f" {each.name}: {', '.join(OUTPUTS)} |" for each in records))
    best = np.max([rows[name] for name in rows if name != "Multirotor"], axis=0)
    for name, row in (*rows.items(), ("best of the others", best)):
        print(
            f"| {name} |"
            + "".join(" " + ", ".join(f"{x:.0f}" for x in each) + " |" for each in row)
        )


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
    system = fit.model.system()
    models = {"Multirotor": system} | foreign(chosen["identification"], methods, orders)
    full = [record.resample(0.01).decimate(2) for record in roles["validation"]]
    for horizon in HORIZONS:
        table(models, full, horizon)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", nargs="+", default=("N4SID", "CVA", "PARSIM-K"))
    parser.add_argument("--order", nargs="+", type=int, default=range(2, 17))
    asked = parser.parse_args()
    main(asked.method, asked.order)
