"""Conditions on a jump or a kink of the equations, against slopes by hand."""

import warnings

import casadi as ca
import pytest

from casid import NonlinearModel, Scalar, parameter


class Roll(NonlinearModel):
    """p' = (L0 or L1) p + Llat lat: another damping beyond a rate."""

    states, inputs, outputs = ("p",), ("lat",), ("p",)
    L0: Scalar = parameter(default=-0.8, lower=-9.0, upper=0.0, unit="1/s")
    L1: Scalar = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=4.0, lower=0.0, upper=50.0, unit="1/s^2")

    def derivatives(self, x, u):
        damping = ca.if_else(ca.fabs(x.p) > 0.5, self.L1, self.L0)
        return [damping * x.p + self.Llat * u.lat]


class Friction(Roll):
    def derivatives(self, x, u):
        return [self.L0 * x.p + self.L1 * ca.sign(x.p) + self.Llat * u.lat]


class Deadband(Roll):
    """Of the stick what is beyond 0.05; a damping with its square, which has no kink at rest."""

    def derivatives(self, x, u):
        beyond = ca.if_else(ca.fabs(u.lat) < 0.05, 0, u.lat - 0.05 * ca.sign(u.lat))
        return [self.L0 * x.p + self.L1 * x.p * ca.fabs(x.p) + self.Llat * beyond]


class OneSided(Roll):
    def derivatives(self, x, u):
        return [self.L0 * ca.fabs(x.p) + self.Llat * ca.fmax(u.lat, 0)]


@pytest.mark.parametrize(
    ("model", "place", "words"),
    [
        (Friction(), {}, ["dp/dt jumps at p = 0"]),
        (Friction(), {"p": 0.1}, []),
        (Deadband(), {}, []),
        (Deadband(), {"lat": 0.05}, ["slope by lat of 0 below and of 4 above lat = 0.05"]),
        (Deadband(), {"lat": -0.05}, ["slope by lat of 4 below and of 0 above lat = -0.05"]),
        (Deadband(), {"lat": 0.051, "p": 3.0}, []),
        (OneSided(), {"lat": 0.1}, ["dp/dt has a slope by p of 0.8 below and of -0.8 above p = 0"]),
        (OneSided(), {"p": -1.0}, ["dp/dt has a slope by lat of 0 below and of 4 above lat = 0"]),
        (OneSided(), {}, ["slope by p of 0.8 below", "slope by lat of 0 below"]),
        (Roll(), {"p": 0.5}, ["dp/dt jumps at p = 0.5"]),
        (Roll(), {}, []),
    ],
)
def test_a_condition_on_a_jump_or_a_kink_is_told_by_equation_and_channel(model, place, words):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        model.at(place)
    said = "".join(str(each.message) for each in told)
    assert said.count(" at ") + said.count("has a slope") == len(words)
    assert all(each in said for each in words)
    assert ("the slope there belongs to neither side" in said) == bool(words)
