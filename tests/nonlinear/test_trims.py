"""Trims found from the equations."""

from dataclasses import replace
from types import MappingProxyType

import casadi as ca
import numpy as np
import pytest
from truths.swing import Swing

from casid import (
    DataWarning,
    ModelError,
    NonlinearModel,
    Record,
    Scalar,
    Trim,
    equations_of,
    find_trim,
    parameter,
    spline,
)
from casid.nonlinear.balance import balanced
from casid.nonlinear.trims import warn_astray
from casid.shooting.simulation import simulate
from models.longitudinal_aero import LongitudinalAero


def test_the_trim_of_a_pendulum_is_by_hand():
    model = Swing(M=6.0, Mlon=8.0)
    trim = find_trim(model, {"theta": 0.4}, ["lon"], name="up")
    assert trim.values["lon"] == pytest.approx(6 * np.tan(0.4) / 8)
    assert trim.values["theta"] == 0.4
    assert trim.name == "up"


def test_a_fixed_wing_in_trim_carries_its_weight():
    model = LongitudinalAero()
    trim = find_trim(model, {"V": 45.0}, ["alpha", "theta", "elevator"])
    alpha, elevator = trim.values["alpha"], trim.values["elevator"]
    CL = model.CL0 + model.CLalpha * alpha + model.CLelevator * elevator
    lift = model.rho * 45**2 / 2 * model.S * CL / model.m
    climb = trim.values["theta"] - alpha
    assert lift + model.thrust * np.sin(alpha) == pytest.approx(model.g * np.cos(climb))
    assert model.Cm0 + model.Cmalpha * alpha + model.Cmelevator * elevator == pytest.approx(0.0)


def test_several_trims_are_told():
    # Without stick the pendulum rests hanging and standing.
    with pytest.warns(DataWarning, match="not the only one: also theta = "):
        trim = find_trim(Swing(), {"theta": 1.55, "lon": 0.0}, ["theta"])
    assert np.sin(trim.values["theta"]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("start", [0.0, 0.8, 1.2])
def test_a_trim_beside_the_one_that_is_found_is_told(start):
    # sin(theta) = 0.999 holds 0.045 rad to either side of the horizontal.
    class Held(Swing):
        def derivatives(self, x, u):
            return [self.Mq * x.q - self.M * (ca.sin(x.theta) - u.lon), x.q]

    other = np.pi - np.arcsin(0.999)
    with pytest.warns(DataWarning, match=f"not the only one: also theta = {other:.4g}"):
        trim = find_trim(Held(), {"theta": start, "lon": 0.999}, ["theta"])
    assert trim.values["theta"] == pytest.approx(np.arcsin(0.999))


@pytest.mark.parametrize(
    ("known", "unknown", "told"),
    [
        ({"q": 0.3}, ["lon"], "no trim here: with lon unknown dtheta/dt stays at 0.3"),
        ({"p": 0.3}, ["lon"], "Swing has no state or input 'p'"),
        ({"q": 0.0}, [], "nothing is unknown"),
    ],
)
def test_where_there_is_no_trim_the_equation_is_named(known, unknown, told):
    with pytest.raises(ModelError, match=told):
        find_trim(replace(Swing(), M=5.0), known, unknown)


class Falling(Swing):
    """A pendulum whose reference condition nothing holds."""

    def reference(self):
        return {"theta": 0.4}


def test_a_reference_condition_out_of_balance_is_told_where_something_rests_on_it():
    t = 0.05 * np.arange(20)
    record = Record(t, np.zeros((20, 1)), np.zeros((20, 0)), ("lon",), ())
    with pytest.warns(DataWarning, match="Falling is not in balance .* the simulation starts"):
        simulate(Falling(), record)
    simulate(Falling(), record, {"q": 0.0, "theta": 0.4})  # said, hence meant
    with pytest.warns(DataWarning, match=r"what is exported starts there.*find_trim"):
        equations_of(Falling(), 1)


class Rotor(NonlinearModel):
    """An inflow whose thrust has no value where the air is pushed up; a tail that turns at will."""

    states, inputs, outputs = ("v", "psi"), ("col",), ("v",)
    thrust: Scalar = parameter(default=60.0, lower=1.0, upper=500.0, unit="m^2/s^2")
    turn: float = 0.0

    def derivatives(self, x, u):
        return [self.thrust * u.col - x.v * ca.sqrt(x.v), self.turn - 0.1]

    def reference(self):
        return {"v": 0.1, "col": 0.3}


def test_starts_where_equations_have_no_value_are_no_reason_to_give_up():
    trim = find_trim(Rotor(turn=0.1), {"col": 0.3}, ["v"])
    assert trim.values["v"] == pytest.approx(18 ** (2 / 3))
    with pytest.raises(ModelError, match=r"has no finite d/dt at v = -5, .*start the unknown"):
        find_trim(Rotor(turn=0.1), {"v": -5.0}, ["v"])


class Climb(NonlinearModel):
    """Speed and flight path of a point mass, which has no direction at rest."""

    states, inputs, outputs = ("V", "gamma"), ("T", "alpha"), ("V", "gamma")

    k: Scalar = parameter(default=0.2, lower=0.0, upper=1.0, unit="1/m")
    d: Scalar = parameter(default=0.01, lower=0.0, upper=1.0, unit="1/m")
    g: float = 9.80665

    def derivatives(self, x, u):
        along = u.T - self.d * x.V**2 - self.g * ca.sin(x.gamma)
        across = self.k * u.alpha * x.V**2 - self.g * ca.cos(x.gamma)
        return [along, across / x.V]

    def reference(self):
        return {"V": 20.0, "T": 4.0, "alpha": 0.12}


@pytest.mark.second
def test_a_trim_that_the_equations_leave_open_is_one_of_many():
    with pytest.warns(DataWarning, match="determine 2 of gamma, T, alpha, not 3; hold one") as told:
        find_trim(Climb(), {"V": 20.0}, ["gamma", "T", "alpha"])
    assert len(told) == 1, "each of many was told as another trim"


def test_what_has_no_value_is_no_trim():
    with pytest.raises(ModelError, match="no finite d/dt at V = 0"):
        find_trim(Climb(), {"V": 0.0}, ["T", "alpha"])


def test_a_trim_that_was_found_is_held_as_a_measured_one():
    trim = find_trim(Climb(), {"V": 20.0}, ["T", "alpha"])
    assert trim.values["alpha"] == pytest.approx(9.80665 / 80)
    assert trim.moves == {}
    linear = Climb().at(trim)
    k = 0.3
    assert replace(linear, k=k).system().A[1, 0] == pytest.approx(
        k * trim.values["alpha"] + 9.80665 / 400
    )


class Position(NonlinearModel):
    """V' = b u - a V², s' = V: in balance b u = a V², and the position runs on."""

    states, inputs, outputs = ("V", "s"), ("u",), ("V", "s")

    a: Scalar = parameter(default=0.12, lower=0.0, upper=1.0, unit="1/m")
    b: Scalar = parameter(default=1.5, lower=0.0, upper=9.0, unit="m/s^2")

    def derivatives(self, x, u):
        return [self.b * u.u - self.a * x.V**2, x.V]

    def reference(self):
        return {"V": 10.0, "u": 8.0}


def test_a_position_need_not_rest():
    model = Position()
    assert find_trim(model, {"V": 20.0}, ["u"]).values["u"] == pytest.approx(32.0)
    t = 0.05 * np.arange(40)
    record = Record(t, np.full((40, 1), 8.0), np.zeros((40, 0)), ("u",), ())
    simulate(model, record)  # a warning would raise
    assert equations_of(model, 1)
    with pytest.raises(ModelError, match="dV/dt stays at"):
        find_trim(replace(model, b=0.0), {"V": 20.0}, ["u"])


def test_a_structure_of_nothing_but_positions_rests():
    class Drift(NonlinearModel):
        """s' = u - w."""

        states, inputs, outputs = ("s",), ("u",), ("s",)
        w: Scalar = parameter(default=3.0, lower=0.0, upper=9.0, unit="m/s")

        def derivatives(self, x, u):  # noqa: ARG002
            return [u.u - self.w]

    assert find_trim(Drift(), {}, ["u"]).values["u"] == pytest.approx(3.0)
    assert balanced(Drift(), Trim(values={})).found == {"u": pytest.approx(3.0)}


def test_a_condition_far_from_balance_is_told_by_its_least_move():
    # Of q = 0, theta and lon, both of size 1, the least move to 6 sin(theta) = 8 cos(theta) lon.
    lon, theta, truth = 6 * np.tan(0.5) / 8, 0.8, Swing(Mq=-0.8, M=6.0, Mlon=8.0)
    rate = -6 * np.sin(theta) + 8 * np.cos(theta) * lon
    slopes = np.array([-6 * np.cos(theta) - 8 * np.sin(theta) * lon, 8 * np.cos(theta)])
    move = -rate * slopes / (slopes @ slopes)
    assert abs(move[0]) > abs(move[1])
    told = f"at gust (d/dt q = {rate:.3g}, as if theta were {move[0]:+.2g} from its 0.8):"
    wrong, right = (
        Trim(name=name, values={"theta": at, "lon": lon})
        for name, at in (("gust", theta), ("60 kn", 0.55))
    )
    with pytest.warns(DataWarning) as said:
        warn_astray(truth, [right, wrong])
    assert told in str(said[0].message)
    warn_astray(truth, [right])


class Rocket(NonlinearModel):
    """V' = T - d V²."""

    states, inputs, outputs = ("V",), ("T",), ("V",)
    units = MappingProxyType({"V": "m/s", "T": "m/s^2"})
    d: Scalar = parameter(default=0.05, lower=0.0, upper=1.0, unit="1/m")

    def derivatives(self, x, u):
        return [u.T - self.d * x.V**2]


def test_moves_to_balance_count_by_the_airspeed_and_by_shares():
    # V / 15 and T / 20 move alike where the slopes -2 d V = -1.5 and 1 times these sizes are.
    rate, slopes = 20 - 0.05 * 15**2, np.array([-1.5 * 15, 20.0])
    V, T = -rate * slopes / (slopes @ slopes) * [15, 20]
    assert abs(V / 15) > abs(T / 20)
    with pytest.warns(
        DataWarning, match=rf"d/dt V = {rate:.3g}, as if V were \+{V:.2g} from its 15"
    ):
        warn_astray(Rocket(), [Trim(values={"V": 15.0, "T": 20.0})])
    warn_astray(Rocket(), [Trim(values={"V": 19.5, "T": 20.0})])


def test_a_trim_beyond_the_tables_is_told():
    class Tabulated(Swing):
        def derivatives(self, x, u):
            lift = spline(x.theta, [-0.2, 0.0, 0.2], [-0.2, 0.0, 0.2])
            return [self.Mq * x.q - self.M * lift + self.Mlon * u.lon, x.q]

    with pytest.warns(DataWarning, match="in trim 'steep': .* is 0.6.* cover -0.2 to 0.2"):
        find_trim(Tabulated(), {"theta": 0.6}, ["lon"], name="steep")
