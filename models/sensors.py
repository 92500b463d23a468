"""Accelerometers that are not at the centre of gravity, for structures that have a rate.

A mixin, to stand before the structure:

    class Boom(Accelerometers, SixDof):
        \"\"\"Six degrees of freedom, the accelerometers forward of the centre of gravity.\"\"\"

A structure without p, q or r (`HeaveInflow`) refuses it: turns reach the instrument there, and it
knows of none. Its parameters are the place [m] from the centre of gravity, forward, right, down.
Where it is known, give it and hold it: ``fixed=("x_acc", "y_acc", "z_acc")``. V. Klein, E. A.
Morelli, Aircraft System Identification: Theory and Practice, 2nd ed., section 3.4.

What identifies it: velocities u, v, w among the outputs, at the centre of gravity; without them the
equations about another point look alike, and the place is to be held or to have a prior value.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from casid import Scalar, Sensor, parameter


@dataclass(frozen=True, kw_only=True)
class Accelerometers:
    """Specific forces measured at (x_acc, y_acc, z_acc)."""

    x_acc: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="m")
    y_acc: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="m")
    z_acc: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="m")

    def sensors(self) -> Mapping[str, Sensor]:
        """One place for all that the structure measures."""
        place = Sensor(x=self.x_acc, y=self.y_acc, z=self.z_acc)
        measured: tuple[str, ...] = getattr(self, "outputs", ())  # those of the structure
        return {name: place for name in ("ax", "ay", "az") if name in measured}
