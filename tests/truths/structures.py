"""Black boxes that know the truth and small structures, for the tests of matching."""

from collections.abc import Mapping, Sequence

import numpy as np

from casid import BlackBox, Constraint, Model, Rows, Scalar, StateSpace, parameter


def black_box(system: StateSpace, band: tuple[float, float] = (0.1, 10.0), **settings) -> BlackBox:
    """A black box that is the system itself."""
    given = {"input_std": np.ones(system.nu), "output_std": np.ones(system.ny)} | settings
    return BlackBox(
        system=system,
        K=np.zeros((system.nx, system.ny)),
        singular_values=np.ones(system.nx),
        pole=np.nan,
        past=1,
        future=1,
        transform="laguerre",
        feedthrough=np.ones((system.ny, system.nu), dtype=bool),
        band=band,
        records=(),
        **given,
    )


class HoverRoll(Model):
    """Roll and sway in hover with a delayed stick."""

    states = ("v", "p", "phi")
    inputs = ("lat",)
    outputs = ("p", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-2.0, upper=0.0, unit="1/s")
    Lv: Scalar = parameter(default=0.0, lower=-1.0, upper=1.0, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=1.0, lower=0.0, upper=100.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.0, lower=0.0, upper=0.3, unit="s")

    def A(self) -> Rows:
        return [[self.Yv, 0, 9.81], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[0], [self.Llat], [0]]

    def delays(self):
        return {"lat": self.tau}


class Product(Model):
    """Two parameters that show as their product alone; with both signs wrong, a worse minimum."""

    states, inputs, outputs = ("p",), ("lat",), ("p",)
    Lp: Scalar = parameter(default=-2.0, lower=-20.0, upper=0.0, unit="1/s")
    k: Scalar = parameter(default=-2.0, lower=-20.0, upper=20.0, unit="-")
    m: Scalar = parameter(default=2.0, lower=-60.0, upper=60.0, unit="-")

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[self.k * self.m]]


class LateRoll(Model):
    """p' = Lp p + Llat lat(t - tau)."""

    states, inputs, outputs = ("p",), ("lat",), ("p",)

    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=60.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.03, lower=0.0, upper=0.25, unit="s")

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[self.Llat]]

    def delays(self):
        return {"lat": self.tau}


class Lag(Model):
    """k / (s + a): two parameters, to be searched by brute force."""

    states = ("x",)
    inputs = ("u",)
    outputs = ("x",)

    a: Scalar = parameter(default=1.0, lower=0.01, upper=20.0, unit="1/s")
    k: Scalar = parameter(default=1.0, lower=-20.0, upper=20.0, unit="-")

    def A(self) -> Rows:
        return [[-self.a]]

    def B(self) -> Rows:
        return [[self.k]]


class TwoByTwo(Model):
    """Roll and yaw from stick and pedal; rolling couples into yaw."""

    states = ("p", "r")
    inputs = ("lat", "ped")
    outputs = ("p", "r")

    Lp: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s")
    Lr: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="1/s")
    Np: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="1/s")
    Nr: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=1.0, lower=0.0, upper=50.0, unit="rad/s^2")
    Nlat: Scalar = parameter(default=0.0, lower=-10.0, upper=10.0, unit="rad/s^2")
    Nped: Scalar = parameter(default=1.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau_lat: Scalar = parameter(default=0.0, lower=0.0, upper=0.3, unit="s")
    tau_ped: Scalar = parameter(default=0.0, lower=0.0, upper=0.3, unit="s")

    def A(self) -> Rows:
        return [[self.Lp, self.Lr], [self.Np, self.Nr]]

    def B(self) -> Rows:
        return [[self.Llat, 0], [self.Nlat, self.Nped]]

    def delays(self):
        return {"lat": self.tau_lat, "ped": self.tau_ped}


# Unstable, as a helicopter in hover is: a pair at 0.09 ± 1.0j.
TRUTH = HoverRoll(Yv=-0.2, Lv=-0.3, Lp=-2.5, Llat=12.0, tau=0.07)
YAW = TwoByTwo(
    Lp=-3.0, Lr=0.4, Np=-0.3, Nr=-1.2, Llat=12.0, Nlat=1.8, Nped=6.0, tau_lat=0.06, tau_ped=0.1
)

# More than a lag can follow.
SECOND = StateSpace([[-1.0, 1.0], [0.0, -3.0]], [[0.5], [2.0]], [[1.0, 0.2]], [[0.0]],
                    inputs=("u",), outputs=("x",))  # fmt: skip


# An actuator that a structure can only answer with its delay.
ACTUATOR = StateSpace(
    [[-0.2, 0, 9.81, 0], [-0.3, -2.5, 0, 12.0], [0, 1, 0, 0], [0, 0, 0, -8.0]],
    [[0], [0], [0], [8.0]], [[0, 1.0, 0, 0], [0, 0, 1.0, 0]], np.zeros((2, 1)),
    inputs=("lat",), outputs=("p", "phi"), delay=np.array([0.05]),
)  # fmt: skip


def structure(**parts):
    """A lag with one part replaced by a faulty one."""
    lag = {
        "states": ("x",), "inputs": ("u",), "outputs": ("x",),
        "__annotations__": {"a": Scalar}, "__module__": __name__,
        "a": parameter(default=-1.0, unit="1/s"),
        "A": lambda self: [[self.a]], "B": lambda _: [[1]],
    }  # fmt: skip
    return type("Lag", (Model,), lag | parts)


class Roll(Model):
    states = ("v", "p", "phi")
    inputs = ("lat", "ped")
    outputs = ("p", "phi")

    Yv: Scalar = parameter(default=-0.1, lower=-1.0, upper=0.0, unit="1/s")
    Lv: Scalar = parameter(default=-0.05, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp: Scalar = parameter(default=-3.0, lower=-9.0, upper=0.0, unit="1/s", scale=2.0)
    Llat: Scalar = parameter(default=20.0, unit="rad/s^2")
    tau: Scalar = parameter(default=0.05, lower=0.0, upper=0.2, unit="s")
    g: float = 9.8

    def A(self) -> Rows:
        return [[self.Yv, 0, self.g], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[0, 0.5], [self.Llat, 0], [0, 0]]

    def delays(self) -> Mapping[str, Scalar]:
        return {"lat": self.tau}

    def constraints(self) -> Sequence[Constraint]:
        return [Constraint("damping", self.Lp + 10 * self.Yv, -20.0, 0.0)]


class Banking(Model):
    """p' = Lp p + Llat lat, and the roll angle."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("p", "phi")

    Lp: Scalar = parameter(default=-3.0, lower=-25.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=8.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Lp, 0], [1, 0]]

    def B(self) -> Rows:
        return [[self.Llat], [0]]
