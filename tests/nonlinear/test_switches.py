"""Equations that jump, and whether records pass where they do."""

import warnings
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy

from casid import (
    ConvergenceError,
    DataWarning,
    NonlinearModel,
    Record,
    Scalar,
    SolverOptions,
    output_error,
    parameter,
)
from casid.nonlinear.switches import deciding, passages
from casid.shooting.uncertainty import singular

T = 0.05 * np.arange(400)
STICK = 0.35 * np.sign(np.sin(1.1 * T))


class Roll(NonlinearModel):
    """p' = (L0 or L1) p + Llat lat: another damping beyond a rate."""

    states, inputs, outputs = ("p",), ("lat",), ("p",)
    L0: Scalar = parameter(default=-0.8, lower=-9.0, upper=0.0, unit="1/s")
    L1: Scalar = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=4.0, lower=0.0, upper=50.0, unit="1/s^2")
    rate: float = 0.5

    def damping(self, p, u):  # noqa: ARG002
        return ca.if_else(ca.fabs(p) > self.rate, self.L1, self.L0) * p

    def derivatives(self, x, u):
        return [self.damping(x.p, u) + self.Llat * u.lat]

    def measurements(self, x, u):  # noqa: ARG002
        return [x.p]


class Friction(Roll):
    def damping(self, p, u):  # noqa: ARG002
        return self.L0 * p + self.L1 * ca.sign(p)


class Kicked(Roll):
    """A moment that changes sides with p: at p = 0 itself it is that below."""

    def damping(self, p, u):  # noqa: ARG002
        return self.L0 * p + ca.if_else(p > 0, self.L1, -self.L1)


class Bent(Roll):
    """The same rates on either side of the threshold, but no slopes."""

    def damping(self, p, u):  # noqa: ARG002
        beyond = self.L1 * (p - self.rate * ca.sign(p)) + self.L0 * self.rate * ca.sign(p)
        return ca.if_else(ca.fabs(p) > self.rate, beyond, self.L0 * p)


class Switched(Roll):
    """Another damping by a switch, whose instants are measured."""

    def damping(self, p, u):
        return ca.if_else(u.lat > 0, self.L1, self.L0) * p


def flown(model):
    """A record of a structure, by steps of a thousandth of a sample's thirtieth."""
    f = model.equations()
    names, lam = ca.SX.sym("p"), model.vector()
    own = ca.Function("f", [names, lat := ca.SX.sym("lat")], [f(names, lat, lam)[0]])

    def rate(t, p):
        return own(p, np.interp(t, T, STICK)).full().ravel()

    found = scipy.integrate.solve_ivp(rate, (0, T[-1]), [0.0], t_eval=T, max_step=0.02, rtol=1e-8)
    y = found.y.T + 0.005 * np.random.default_rng(1).standard_normal((len(T), 1))
    return Record(T, STICK[:, None], y, ("lat",), ("p",), "square")


@pytest.mark.parametrize(
    ("model", "threshold"), [(Roll(), "0.5 = fabs(p)"), (Friction(L1=-0.2), "p = 0")]
)
@pytest.mark.second
def test_jumps_that_records_pass_are_told_as_often_as_they_do(model, threshold):
    record = flown(model)
    x = record.y
    (found,) = passages(model, [(x, record.u)])
    sides = np.abs(x[:, 0]) > 0.5 if model.__class__ is Roll else x[:, 0] > 0
    assert (found.equation, found.threshold) == ("dp/dt", threshold)
    assert found.times == np.sum(sides[1:] != sides[:-1])


@pytest.mark.parametrize(("model", "told"), [(Friction(), "p = 0"), (Kicked(), "0 = p")])
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_a_threshold_in_the_middle_of_a_sample_is_a_jump_too(model, told, up):
    x, u = np.array([[-up], [up]]), np.zeros((2, 1))  # half way p = 0, which is on neither side
    (found,) = passages(model, [(x, u)])
    assert (found.threshold, found.times) == (told, 1)


@pytest.mark.parametrize("model", [Roll(rate=5.0), Bent(), Switched()], ids=["far", "bent", "by u"])
@pytest.mark.second
def test_what_no_parameter_moves_or_does_not_jump_is_not_told(model):
    record = flown(model)
    assert passages(model, [(record.y, record.u)]) == []


@pytest.mark.campaign
def test_a_jump_that_an_input_decides_is_told_where_a_parameter_delays_that():
    record = flown(Switched())
    (found,) = passages(Switched(), [(record.y, record.u)], late=["lat"])
    assert found.times == np.sum(np.diff(record.u[1:, 0] > 0))  # at first there is no rate to damp

    class Late(Switched):
        tau: Scalar = parameter(default=0.06, lower=0.0, upper=0.2, unit="s")

        def delays(self):
            return {"lat": self.tau}

    stick = replace(record, u=0.35 * np.sin(1.1 * T)[:, None])
    for hold, fixed, told in (("foh", (), 1), ("zoh", (), 0), ("foh", ("tau",), 0)):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            output_error(Late(), [replace(stick, hold=hold)], fixed=fixed)
        assert sum("dp/dt jumps at" in str(each.message) for each in caught) == told


class Copied(Friction):
    def damping(self, p, u):  # noqa: ARG002
        return self.L0 * p + self.L1 * ca.copysign(1.0, p)


class Heading(NonlinearModel):
    """psi' = r, measured between -π and π."""

    states, inputs, outputs = ("psi",), ("r",), ("psi",)
    k: Scalar = parameter(default=1.0, lower=0.1, upper=5.0, unit="-")

    def derivatives(self, x, u):  # noqa: ARG002
        return [self.k * u.r]

    def measurements(self, x, u):  # noqa: ARG002
        return [ca.atan2(ca.sin(x.psi), ca.cos(x.psi))]


@pytest.mark.second
def test_signs_that_are_copied_and_angles_that_wrap_jump():
    record = flown(Copied(L1=-0.2))
    (found,) = passages(Copied(L1=-0.2), [(record.y, record.u)])
    assert (found.equation, found.threshold) == ("dp/dt", "p = 0")
    assert found.times == np.sum(np.diff(record.y[:, 0] > 0))
    psi = np.linspace(-0.5, 16.0, 400)[:, None]  # past π, 3π and 5π, and past 0, 2π and 4π
    (found,) = passages(Heading(), [(psi, np.ones((400, 1)))])
    assert (found.equation, found.threshold, found.times) == ("psi", "sin(psi) = 0", 3)


@pytest.mark.campaign
def test_a_fit_says_that_its_errors_miss_how_jumps_move():
    record = flown(Roll())
    with pytest.warns(DataWarning, match=r"Roll: dp/dt jumps at 0.5 = fabs\(p\), passed \d+ times"):
        output_error(Roll(), [record])
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        output_error(Bent(), [flown(Bent())])


@pytest.mark.second
def test_a_fit_that_fails_names_the_jumps_among_the_reasons():
    few = SolverOptions(max_iterations=1)
    with pytest.raises(ConvergenceError, match=r"; dp/dt jumps at 0.5 = fabs\(p\)"):
        output_error(replace(Roll(), L0=-3.0, Llat=9.0), [flown(Roll())], solver=few)
    with pytest.raises(ConvergenceError) as caught:
        output_error(replace(Bent(), L0=-3.0, Llat=9.0), [flown(Bent())], solver=few)
    assert "jumps" not in str(caught.value)


class Threshold(Roll):
    """What decides is a parameter; its like that multiplies too is not one that only decides."""

    th: Scalar = parameter(default=0.4, lower=0.0, upper=2.0, unit="rad/s")

    def damping(self, p, u):  # noqa: ARG002
        return ca.if_else(p > self.th, self.L1, ca.if_else(p < self.L0, self.L0, 0.0)) * p


def test_a_parameter_that_only_decides_is_no_lack_of_data():
    assert deciding(Threshold()) == ["th"]
    assert deciding(Roll()) == []
    said = singular(("th",), Threshold())
    assert said.startswith("th only decides between two expressions (if_else)")
    assert "manoeuvre" not in said
    assert "do not determine L1 here" in singular(("L1", "th"), Threshold())
