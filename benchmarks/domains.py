"""Output error in both domains against a truth of 64 parameters, unstable and flown in closed loop.

    OMP_NUM_THREADS=1 python -m benchmarks.domains [--runs 100] [--first 0]

The truth is six degrees of freedom as matched to the UH-60 example, delays moved between samples.
Four 3-2-1-1 of 16 s and four sweeps of 60 s at 25 Hz are flown in a loop of rates and attitudes,
measured with the example's noise and fed back with it through a lag of 0.1 s. Each line is over
runs and parameters: RMSE over the Cramér-Rao bound (root mean square, least, largest parameter),
coverage of the 95 % intervals by it and by the stated error, the root mean square difference of the
two estimates in standard errors, processor time. Parameters on a bound do not count.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from benchmarks.output_error import INPUTS, OUTPUTS, noisy_records, start_of
from benchmarks.tables import table
from casid import Record, output_error
from casid.linear import foh_step

H, FINE = 0.04, 4  # sampling interval [s], steps of the loop between samples
NOISE = np.array([0.05, 0.05, 0.1, 0.003, 0.003, 0.003, 0.003, 0.003])
DELAYS = {"tau_col": 0.05, "tau_lat": 0.07, "tau_lon": 0.07, "tau_ped": 0.03}
GAIN = np.zeros((4, 8))
GAIN[1, [3, 6]], GAIN[2, [4, 7]], GAIN[3, 5] = (0.05, 0.15), (0.20, 0.25), 0.20
LAG, SIZE = 0.1, {"col": 0.04, "lat": 0.04, "lon": 0.025, "ped": 0.05}


def truth():
    """Six degrees of freedom close to the UH-60 of the example."""
    return replace(start_of(noisy_records()), **DELAYS)


def commands():
    """Reference inputs (N, 4) of every manoeuvre, with its name."""
    for kind, length in (("3211", 16.0), ("sweep", 60.0)):
        t = H * np.arange(round(length / H) + 1)
        for j, name in enumerate(INPUTS):
            r = np.zeros((len(t), 4))
            if kind == "3211":
                r[:, j] = sum(s * ((t > a) & (t <= b)) for s, a, b in
                              ((1, 2, 5), (-1, 5, 7), (1, 7, 8), (-1, 8, 9)))  # fmt: skip
            else:
                since, rate = np.clip(t - 2, 0, 56), np.log(12 / 0.3)
                fade = np.clip(np.minimum(since / 5, (59 - t) / 2), 0, 1)
                r[:, j] = fade * np.sin(0.3 * 56 / rate * (np.exp(rate * since / 56) - 1))
            yield f"{kind}_{name}", t, r * SIZE[name]


def flown(model, name, t, r, rng):
    """One record of the loop; sticks are straight lines between samples."""
    system, h = model.system(), H / FINE
    A_d, B0, B1 = foh_step(system.A, system.B, h)
    late = np.rint(system.delay / h).astype(int)
    assert np.allclose(late * h, system.delay)
    noise = NOISE * rng.standard_normal((len(t), 8))
    u, y = np.zeros((FINE * (len(t) - 1) + 1, 4)), np.zeros((len(t), 8))
    x, share = np.zeros(system.nx), 1 - np.exp(-H / LAG)

    def stick(k):
        return np.array([u[max(k - late[j], 0), j] for j in range(4)])

    for n in range(len(t)):
        y[n] = system.C @ x + system.D @ stick(FINE * n)
        if n + 1 == len(t):
            break
        now = u[FINE * n]
        goal = now + share * (r[n] - GAIN @ (y[n] + noise[n]) - now)
        for k in range(1, FINE + 1):
            u[FINE * n + k] = now + (goal - now) * k / FINE
        for k in range(FINE * n, FINE * (n + 1)):
            x = A_d @ x + B0 @ stick(k) + B1 @ stick(k + 1)
    return Record(t, u[::FINE], y + noise, INPUTS, OUTPUTS, name)


def measure(runs, first):
    """Fits of both domains to every run."""
    model = truth()
    print(f"fastest growing mode of the truth {model.system().poles()[0]:.3g} 1/s", flush=True)
    true, found = model.vector(), {domain: [] for domain in ("time", "frequency")}
    for run in range(first, first + runs):
        rng = np.random.default_rng([run, 7])
        records = [flown(model, *each, rng) for each in commands()]
        for domain, rows in found.items():
            begin = time.process_time()
            fit = output_error(model, records, domain=domain)
            taken = time.process_time() - begin
            table_of = fit.parameters
            rows.append(
                (
                    [row.value for row in table_of],
                    [row.cramer_rao for row in table_of],
                    [row.std_error for row in table_of],
                    taken,
                )
            )
        print(f"run {run}: {[rows[-1][3] for rows in found.values()]} s", flush=True)
    return true, found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    true, found = measure(options.runs, options.first)
    rows, estimates = [], {}
    for domain, each in found.items():
        values, bound, stated = (np.array([row[k] for row in each]) for k in range(3))
        z, robust = (values - true) / bound, (values - true) / stated
        ratio = np.sqrt(np.nanmean(z**2, axis=0))
        estimates[domain] = values, bound
        rows.append([domain, np.sqrt(np.nanmean(z**2)), np.nanmin(ratio), np.nanmax(ratio),
                     100 * np.mean(np.abs(z[np.isfinite(z)]) < 1.96),
                     100 * np.mean(np.abs(robust[np.isfinite(robust)]) < 1.96),
                     float(np.median([row[3] for row in each]))])  # fmt: skip
    print(table(["domain", "RMSE / CR", "least", "largest", "covered %", "by stated error %",
                 "processor [s]"], rows))  # fmt: skip
    (t, bound), (f, _) = estimates["time"], estimates["frequency"]
    print(f"difference of the two, rms: {np.sqrt(np.nanmean(((t - f) / bound) ** 2)):.3g} σ")


if __name__ == "__main__":
    main()
