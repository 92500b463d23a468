"""Whether the kinematic check's standard errors are right, and how often it gives a false alarm.

Run: python benchmarks/kinematics.py      (three minutes)
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from truths.flights import ERRORS, FORCES, NOISE, RATES, STATES, flight, scores

from casid import kinematic_check, read_csv

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


if __name__ == "__main__":
    main()
