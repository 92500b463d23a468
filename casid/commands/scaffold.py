"""A first model file, commented, for a user to change."""

import keyword
from pathlib import Path

from casid.files import write_text

TEMPLATE = '''"""{title}: roll and sideslip about level flight.

    v' = Yv v + g phi             p' = Lv v + Lp p + Llat lat(t - tau_lat)             phi' = p

Change this file to what your aircraft needs, then look at it with

    casid check {file}:{name}
"""

from collections.abc import Mapping

from casid import Model, Rows, Scalar, parameter


class {name}(Model):
    """Roll of a helicopter near hover; moment derivatives are over the inertia."""

    # Names: inputs and outputs are the columns of your records (SI units, radians). Read a stick
    # in percent with units "%": it becomes a fraction of full travel.
    states = ("v", "p", "phi")
    inputs = ("lat",)
    outputs = ("p", "phi")

    # Parameters to estimate: guess, bounds (leave one out where there is none) and unit. A bound
    # is knowledge: damping is negative, a stick to the right rolls to the right.
    Yv: Scalar = parameter(default=-0.1, lower=-1.0, upper=0.0, unit="1/s")
    Lv: Scalar = parameter(default=-0.1, lower=-1.0, upper=1.0, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-2.0, lower=-25.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=60.0, unit="rad/s^2")
    tau_lat: Scalar = parameter(default=0.05, lower=0.0, upper=0.25, unit="s")

    # Plain numbers are never estimated: trim, gravity.
    g: float = 9.80665

    def A(self) -> Rows:
        return [
            #    v        p        phi
            [self.Yv, 0, self.g],  # v'
            [self.Lv, self.Lp, 0],  # p'
            [0, 1, 0],  # phi'
        ]

    def B(self) -> Rows:
        return [[0], [self.Llat], [0]]

    # C and D are written only if an output is no state: here they need not be, p and phi are.
    # Specific forces do need them: see models/six_dof.py.

    def delays(self) -> Mapping[str, Scalar]:
        return {{"lat": self.tau_lat}}

    # A tie or an inequality between parameters, if you know one (import Sequence and Constraint):
    #
    #     def constraints(self) -> Sequence[Constraint]:
    #         return [Constraint("dihedral", self.Lv / self.Lp, lower=0.0, upper=0.2)]
'''


def new_model(name: str) -> tuple[Path, str]:
    """Write a model file that checks; its path and the name of its class.

    The name is ``my_roll``, ``my_roll.py`` or a path with folders that are there; the class is then
    ``MyRoll``. ValueError: no name for Python, a file that is there, a folder that is not.
    """
    path = Path(name)
    path = path if path.suffix == ".py" else path.with_name(f"{path.name}.py")
    stem = path.stem
    if not stem.isidentifier() or not stem.isascii() or keyword.iskeyword(stem):
        raise ValueError(
            f"{name!r}: a model file needs a name that Python imports, such as my_roll "
            "(letters, digits and _, a letter first)"
        )
    words = "".join(word[:1].upper() + word[1:] for word in stem.split("_"))
    if not words[:1].isalpha() or words == "Model":
        raise ValueError(f"{name!r}: no class can be named after it; try my_{stem.strip('_')}")
    text = TEMPLATE.format(title=words, name=words, file=path)
    if path.exists():
        raise ValueError(f"{path} is there already and is left as it is; choose another name")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}; make it first")
    write_text(path, text)
    return path, words
