"""Run other implementations on one problem; started by `peers.py` under their interpreter.

    python peer_worker.py PROBLEM.npz ANSWER.npz

The problem holds u (N, nu), y (N, ny), orders, methods, horizon and feedthrough; the answer, for
every method and order that gave a model, its A, B, C, D, K and the seconds it took.
"""

import contextlib
import io
import sys
import time
import warnings

import numpy as np
import pandas as pd
from nfoursid.nfoursid import NFourSID
from sippy_unipi import system_identification


def sippy(u, y, method, order, horizon, feedthrough):
    model = system_identification(
        y.T.copy(), u.T.copy(), method, SS_f=horizon, SS_p=horizon, SS_fixed_order=order,
        SS_D_required=feedthrough,
    )  # fmt: skip
    return model.A, model.B, model.C, model.D, model.K


def nfoursid(u, y, order, horizon):
    inputs = [f"u{i}" for i in range(u.shape[1])]
    outputs = [f"y{i}" for i in range(y.shape[1])]
    frame = pd.DataFrame(np.hstack([u, y]), columns=inputs + outputs)
    task = NFourSID(frame, outputs, inputs, num_block_rows=horizon)
    task.subspace_identification()
    model, _ = task.system_identification(rank=order)
    return model.a, model.b, model.c, model.d, 0 * model.c.T


def identify(u, y, method, order, horizon, feedthrough):
    if method == "nfoursid":
        return nfoursid(u, y, order, horizon)
    return sippy(u, y, method, order, horizon, feedthrough)


def main(problem, answer):
    task = np.load(problem)
    u, y = task["u"], task["y"]
    horizon, feedthrough = int(task["horizon"]), bool(task["feedthrough"])
    found = {}
    methods = [str(method) for method in task["methods"]]
    for method in methods:  # what a first call compiles or loads is nobody's running time
        with contextlib.suppress(Exception), contextlib.redirect_stdout(io.StringIO()):
            identify(u[:200], y[:200], method, 1, 3, feedthrough)
    for method in methods:
        for order in task["orders"].tolist():
            begin = time.perf_counter()
            try:
                with contextlib.redirect_stdout(io.StringIO()):
                    matrices = identify(u, y, method, order, horizon, feedthrough)
            except Exception as error:  # noqa: BLE001 - a foreign method fails as it likes
                print(f"{method}, order {order}: {error}", file=sys.stderr)
                continue
            seconds = time.perf_counter() - begin
            values = [np.real(np.asarray(each)) for each in matrices]
            if all(np.isfinite(each).all() for each in values):
                found[f"{method}|{order}|seconds"] = np.array(seconds)
                for letter, each in zip("ABCDK", values, strict=True):
                    found[f"{method}|{order}|{letter}"] = each
    np.savez(answer, **found)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(*sys.argv[1:])
