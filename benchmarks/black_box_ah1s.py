"""Accuracy of the black box on the AH-1S of JSBSim, settings chosen from data.

    python -m benchmarks.black_box_ah1s

The campaigns of `examples/paper.py`: four 3-2-1-1 and four sweeps with light feedback, with noise.
References: the conditioned responses of the noise-free sweeps at 40 frequencies in 0.5-12 rad/s,
and, for rates and attitudes below 3 rad/s, the
quasi-steady eight-state model. e and on-axis error as in `uh60.py`.
"""

import time

import numpy as np

from benchmarks.tables import table
from casid import frequency_response, pbsid
from casid.records import standard_deviations
from examples.paper import ANGLES, RATES, ah1s, quasi_steady, read

OMEGA = np.geomspace(0.5, 12.0, 40)
ON_AXIS = (("az", "col"), ("p", "lat"), ("q", "lon"), ("r", "ped"))


def relative_error(system, reference, outputs, omega, records):
    """Median over ω of the scaled Frobenius error, and the median on-axis one."""
    su, sy = standard_deviations(records)
    rows = [system.outputs.index(name) for name in outputs]
    G = reference(omega)
    G_hat = system.response(omega)[:, rows]
    scale = su / sy[rows, None]
    sizes = [np.linalg.norm(X * scale, axis=(1, 2)) for X in (G_hat - G, G)]
    pairs = [(outputs.index(y), system.inputs.index(u)) for y, u in ON_AXIS if y in outputs]
    on_axis = [np.median(np.abs(G_hat[:, i, j] / G[:, i, j] - 1)) for i, j in pairs]
    return 100 * np.median(sizes[0] / sizes[1]), 100 * np.median(on_axis)


def main():
    case = ah1s()
    noise_free = read("ah1s", [record.name for record in case.sweeps])
    exact = frequency_response(noise_free, omega=OMEGA)
    low = OMEGA[OMEGA <= 3.0]
    rows = []
    for name, records in (("all eight", [*case.steps, *case.sweeps]), ("3-2-1-1", case.steps)):
        begin = time.process_time()
        box = pbsid(records, feedthrough=["ax", "ay", "az"])
        seconds = time.process_time() - begin
        settings = f"{box.order}/{box.past}/{box.pole:g}/{box.regularisation:g}"
        e, on = relative_error(box.system, lambda _: exact.G, box.system.outputs, OMEGA, records)
        rows.append([name, "noise-free sweeps", e, on, seconds, settings])
        e, on = relative_error(box.system, quasi_steady().response, (*RATES, *ANGLES), low, records)
        rows.append([name, "quasi-steady model, < 3 rad/s", e, on, seconds, settings])
    header = ["campaign", "reference", "e [%]", "on axis [%]", "CPU [s]",
              "order/past/pole/regularisation"]  # fmt: skip
    print(table(header, rows))


if __name__ == "__main__":
    main()
