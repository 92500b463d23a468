"""A structure of one's own: roll and pitch of an articulated rotor, identified from CSV files.

Above 2 rad/s speed and attitude hardly act back on the rates; the tip-path plane shapes them. Four
states and two sticks say so in forty lines, which follow the off-axis response that the
quasi-steady six degrees of freedom miss with all their 64 parameters.
"""

import sys
from pathlib import Path

import numpy as np

from casid import (
    Model,
    Rows,
    Scalar,
    derivid,
    frequency_response,
    identifiability,
    parameter,
    read_csv,
)

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from models.six_dof import SixDof  # noqa: E402 - found through the line above


class DiskTilt(Model):
    """Roll and pitch rates p, q driven by the tip-path plane's tilt b1s, b1c [rad]."""

    states = ("p", "q", "b1c", "b1s")
    inputs = ("lat", "lon")
    outputs = ("p", "q")

    Lb1c: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Lb1s: Scalar = parameter(default=50.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mb1c: Scalar = parameter(default=20.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Mb1s: Scalar = parameter(default=0.0, lower=-200.0, upper=200.0, unit="1/s^2")
    Llat: Scalar = parameter(default=5.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Llon: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlat: Scalar = parameter(default=0.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mlon: Scalar = parameter(default=5.0, lower=-60.0, upper=60.0, unit="rad/s^2")
    Mfc: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Mfs: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Lfc: Scalar = parameter(default=0.0, lower=-30.0, upper=30.0, unit="1/s")
    Lfs: Scalar = parameter(default=-10.0, lower=-40.0, upper=0.0, unit="1/s")
    Mflat: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")
    Mflon: Scalar = parameter(default=1.0, lower=-20.0, upper=20.0, unit="rad/s")
    Lflat: Scalar = parameter(default=1.0, lower=-20.0, upper=20.0, unit="rad/s")
    Lflon: Scalar = parameter(default=0.0, lower=-20.0, upper=20.0, unit="rad/s")

    def A(self) -> Rows:
        return [
            [0, 0, self.Lb1c, self.Lb1s],
            [0, 0, self.Mb1c, self.Mb1s],
            [0, -1, self.Mfc, self.Mfs],
            [-1, 0, self.Lfc, self.Lfs],
        ]

    def B(self) -> Rows:
        return [
            [self.Llat, self.Llon],
            [self.Mlat, self.Mlon],
            [self.Mflat, self.Mflon],
            [self.Lflat, self.Lflon],
        ]


CHANNELS = {"inputs": SixDof.inputs, "outputs": SixDof.outputs, "detrend": "first"}
UNITS = dict.fromkeys(SixDof.inputs, "%")  # sticks become fractions of full travel
FILES = [ROOT / f"examples/uh60/data/sweep_{stick}.csv" for stick in SixDof.inputs]
PAIRS = [(rate, stick) for rate in ("p", "q") for stick in ("lat", "lon")]

records = [read_csv(file, units=UNITS, **CHANNELS) for file in FILES]
measured = frequency_response(records, omega=np.geomspace(2.0, 12.0, 20))
print(f"before the fit: {identifiability(DiskTilt(), measured)}")

fit = derivid(DiskTilt(), measured, starts=2)
rigid = derivid(SixDof(U0=40.9, V0=2.8, W0=2.05, theta0=0.053), measured, starts=2)
J, J_rigid = (
    {(row.output, row.input): row.J for row in result.notes.pairs} for result in (fit, rigid)
)
for pair in PAIRS:
    print(f"{pair[0]}/{pair[1]}: J = {J[pair]:.0f}, six degrees of freedom {J_rigid[pair]:.0f}")

assert max(J[pair] for pair in PAIRS) < 100  # what counts as a good model
assert sum(J[pair] for pair in PAIRS) < 0.5 * sum(J_rigid[pair] for pair in PAIRS)
