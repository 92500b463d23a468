"""Whether the kinematic check's standard errors are right, and how often it gives a false alarm.

Last, skews of single channels of the UH-60 with noise, five outliers and 1 % of the samples missing
in each record, beside the least error that any unbiased estimate of a delay has: of a rate seen in
white noise of density σ_rate² against an attitude in σ_attitude², the Cramér-Rao bound is

    σ⁻² = Σ_k 2 ω_k² |X(ω_k)|² / (N (σ_rate² + ω_k² σ_attitude²)),    X: transform of the rate.

Run: python -m benchmarks.kinematics      (ten minutes)
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from truths.flights import ERRORS, FORCES, NOISE, RATES, STATES, flight, scores

from benchmarks.flights import spiked
from benchmarks.uh60 import NOISE as SPREAD
from benchmarks.uh60 import STEPS, SWEEPS, nonlinear_records
from casid import kinematic_check, read_csv
from casid.consistency.instruments import OWN

FLIGHTS = 30
CHANNELS = {
    "rates, forces, attitudes, heading, velocities": (*RATES, *FORCES, *STATES),
    "rates, φ, θ": (*RATES, "phi", "theta"),
    "rates, φ, θ, ψ": (*RATES, "phi", "theta", "psi"),
}


INPUTS, TURNED = ("col", "lat", "lon", "ped"), ("phi", "theta")
DATA = Path(__file__).parent.parent / "examples" / "uh60" / "data"
GOOD = dict.fromkeys(("ax", "ay"), 0.05) | {"az": 0.1} | dict.fromkeys((*RATES, *TURNED), 0.003)
CAMPAIGNS = 15
MOVED = {"p": ("p", 0.06), "q": ("q", -0.06), "phi": ("p", 0.06), "theta": ("q", 0.03)}  # s
WANTED, SEEDS = 0.005, range(100, 106)  # s


def helicopter():
    """How often noise alone raises a remark on four manoeuvres in which little moves but rates."""
    outputs = (*FORCES, *RATES, *TURNED, "u", "v", "w")
    files = [DATA / f"3211_{axis}.csv" for axis in INPUTS]
    records = [read_csv(file, inputs=INPUTS, outputs=outputs) for file in files]
    print("\n| noise of u, v, w [m/s] | campaigns with a remark | remarks |\n|---|---|---|")
    for speed in (0.0, 0.1, 0.3):
        std = GOOD | dict.fromkeys(("u", "v", "w"), speed)
        found = []
        for seed in range(CAMPAIGNS):
            rng = np.random.default_rng([seed, 2])
            found.append(kinematic_check([each.with_noise(std, rng) for each in records]).remarks)
        alarms = sum(bool(each) for each in found)
        print(f"| {speed:g} | {alarms} of {CAMPAIGNS} | {sum(map(len, found))} |")


def later(record, name, lag):
    """The record, one channel so much later."""
    y, i = record.y.copy(), record.outputs.index(name)
    at = np.clip(record.t - lag, record.t[0], record.t[-1])
    y[:, i] = scipy.interpolate.CubicSpline(record.t, y[:, i])(at)
    return replace(record, y=y)


def spoilt(record, rng):
    """The record with noise, five outliers and 1 % of its samples missing."""
    record = spiked(record.with_noise(SPREAD, rng), rng)
    return record.mask(rng.random(record.y.shape) < 0.01)


def least(records, rate, attitude):
    """Standard deviation that an unbiased estimate of their delay [s] has at least."""
    known = 0.0
    for record in records:
        x, omega = record.channel(rate), 2 * np.pi * np.fft.rfftfreq(record.N, record.dt)
        power = 2 * np.abs(np.fft.rfft(x - x.mean())) ** 2 / record.N
        known += np.sum(omega**2 * power / (SPREAD[rate] ** 2 + (omega * SPREAD[attitude]) ** 2))
    return 1 / np.sqrt(known)


def skews():
    """Errors of the skews of single channels in spoilt records."""
    print("\n| late | records | rms error [ms] | stated | least | within 5 ms |")
    print("|---|---|---|---|---|---|")
    for names in (STEPS, SWEEPS):
        whole = nonlinear_records(names)
        for channel, (rate, lag) in MOVED.items():
            moved, found = [later(record, channel, lag) for record in whole], []
            for seed in SEEDS:
                rng = np.random.default_rng([seed, 3])
                checks = kinematic_check([spoilt(record, rng) for record in moved]).channels
                (check,) = (each for each in checks if each.channel == rate)
                true = lag if channel == rate else -lag
                found.append([check.skew - true, check.skew_error])
            (error, stated), bound = np.transpose(found), least(whole, rate, OWN[rate])
            said = (np.sqrt(np.mean(error**2)), stated.mean(), bound)
            figures = " | ".join(f"{1e3 * value:.1f}" for value in said)
            within = f"{np.sum(np.abs(error) < WANTED)} of {len(SEEDS)}"
            print(f"| {channel} {1e3 * lag:+.0f} ms | {names[0][:-4]} | {figures} | {within} |")


def main():
    print("| channels | scale | bias | skew | largest of all | false alarms |")
    print("|---|---|---|---|---|---|")
    for name, outputs in CHANNELS.items():
        found = [kinematic_check([flight(k, ERRORS, NOISE, outputs)]) for k in range(FLIGHTS)]
        z = np.concatenate([scores(check) for check in found])
        clean = [kinematic_check([flight(k, None, NOISE, outputs)]) for k in range(FLIGHTS)]
        alarms = sum(not check.consistent for check in clean)
        rms = " | ".join(f"{value:.2f}" for value in np.sqrt(np.mean(z**2, axis=0)))
        print(f"| {name} | {rms} | {np.abs(z).max():.1f} | {alarms} of {FLIGHTS} |")
    helicopter()
    skews()


if __name__ == "__main__":
    main()
