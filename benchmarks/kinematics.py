"""Whether the kinematic check's standard errors are right, and how often it gives a false alarm.

Run: python benchmarks/kinematics.py      (a minute)
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from truths.flights import ERRORS, FORCES, NOISE, RATES, STATES, flight, scores

from casid import kinematic_check

FLIGHTS = 30
CHANNELS = {
    "rates, forces, attitudes, heading, velocities": (*RATES, *FORCES, *STATES),
    "rates, φ, θ": (*RATES, "phi", "theta"),
    "rates, φ, θ, ψ": (*RATES, "phi", "theta", "psi"),
}


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


if __name__ == "__main__":
    main()
