"""Linearisation at flight conditions."""

import pickle

import numpy as np
import pytest
from truths.swing import Swing

from casid import ModelError, NonlinearModel, Scalar, StateSpace, Trim, match, parameter
from casid.free import free_parameters


def slopes(model, x0, u0, step=1e-6):
    """A and B by central differences of the equations."""
    f = model.equations()
    point, nx = np.concatenate([x0, u0]), len(x0)
    columns = []
    for i in range(len(point)):
        ends = [point + sign * step * np.eye(len(point))[i] for sign in (1, -1)]
        up, down = (f(e[:nx], e[nx:], model.vector())[0].full().ravel() for e in ends)
        columns.append((up - down) / (2 * step))
    return np.array(columns).T


def test_the_linear_structure_is_the_jacobian_at_the_trim():
    model = Swing()
    linear = model.at(Trim(values={"theta": 0.4, "lon": 0.3}))
    expected = slopes(model, np.array([0.0, 0.4]), np.array([0.3]))
    system = linear.system()
    np.testing.assert_allclose(np.hstack([system.A, system.B]), expected, atol=1e-8)
    assert linear.parameter_names() == model.parameter_names()
    assert system.delay[0] == model.tau


def test_linear_structures_travel_to_other_processes():
    linear = Swing().at(Trim(values={"theta": 0.4}, unknown=("lon",)))
    assert pickle.loads(pickle.dumps(linear)) == linear


@pytest.mark.second
def test_an_unknown_of_the_trim_is_estimated_with_the_parameters():
    # The black box is exact; the stick that holds theta = 0.4 follows from the balance alone.
    truth = Swing(Mq=-0.8, M=6.0, Mlon=8.0, tau=0.05)
    lon = 6.0 * np.tan(0.4) / 8.0
    target = truth.at({"theta": 0.4, "lon": lon}).system()
    start = Swing().at(Trim(values={"theta": 0.4, "lon": 0.1}, unknown=("lon",)))
    fit = match(start, target, norm="quadratic")
    for name in ("Mq", "M", "Mlon", "tau"):
        assert fit[name].value == pytest.approx(getattr(truth, name), rel=1e-5)
    assert fit["lon_trim"].value == pytest.approx(lon, rel=1e-5)


def test_conditions_side_by_side_are_the_single_ones():
    low, high = Trim(name="low", values={}), Trim(name="high", values={"theta": 1.0})
    both = Swing().at(low, high).system()
    for k, trim in enumerate((low, high)):
        alone = Swing().at(trim).system()
        np.testing.assert_array_equal(both.A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2], alone.A)
        np.testing.assert_array_equal(both.B[2 * k : 2 * k + 2, [k]], alone.B)
    assert not both.A[:2, 2:].any()
    assert both.outputs == ("q@low", "theta@low", "q@high", "theta@high")


def test_a_balance_out_of_reach_is_told():
    # theta' = q has nothing unknown in it.
    trim = Trim(name="spin", values={"q": 0.3}, unknown=("lon",))
    with pytest.raises(ModelError, match=r"trim 'spin': dtheta/dt is 0.3 whatever"):
        free_parameters(Swing().at(trim))


@pytest.mark.parametrize(
    ("trims", "told"),
    [
        ([Trim(values={}, unknown=("ped",))], "unknown 'ped' is no state or input of Swing"),
        ([Trim(values={}), Trim(values={})], "give each its own"),
    ],
)
def test_bad_trims_are_told(trims, told):
    with pytest.raises(ModelError, match=told):
        Swing().at(*trims)


class Turning(Swing):
    """A pendulum on a table that turns as a constant says."""

    turn: float = 0.0

    def derivatives(self, x, u):
        dq, _ = super().derivatives(x, u)
        return [dq, x.q - self.turn]

    def reference(self):
        return {"lon": 0.3}


def test_balance_is_that_of_the_structures_own_constants():
    trim = Trim(values={"q": 0.1, "theta": 0.2}, unknown=("lon",))
    assert [each.name for each in Turning(turn=0.1).at(trim).constraints()] == ["trim '': dq/dt"]
    still = Trim(values={"theta": 0.2}, unknown=("lon",))
    with pytest.raises(ModelError, match=r"dtheta/dt is -0\.1 whatever"):
        Turning(turn=0.1).at(still).constraints()


def test_an_unknown_that_is_not_named_starts_from_the_reference():
    assert Turning().at(Trim(values={}, unknown=("lon",))).lon_trim == 0.3
    both = (Trim(name=name, values=values, unknown=("lon",)) for name, values in
            (("a", {}), ("b", {"lon": 0.1})))  # fmt: skip
    linear = Turning().at(*both)
    assert (linear.lon_trim_1, linear.lon_trim_2) == (0.3, 0.1)


def test_a_position_does_not_have_to_be_balanced_by_an_unknown():
    class Position(NonlinearModel):
        """V' = b u - a V², s' = V."""

        states, inputs, outputs = ("V", "s"), ("u",), ("V", "s")

        a: Scalar = parameter(default=0.1, lower=0.01, upper=1.0, unit="1/m")
        b: Scalar = parameter(default=1.0, lower=0.1, upper=9.0, unit="m/s^2")

        def derivatives(self, x, u):
            return [self.b * u.u - self.a * x.V**2, x.V]

        def reference(self):
            return {"V": 10.0, "u": 10.0}

    target = StateSpace(
        [[-2.4, 0.0], [1.0, 0.0]], [[1.5], [0.0]], np.eye(2), np.zeros((2, 1)),
        inputs=("u",), outputs=("V", "s"),
    )  # fmt: skip
    start = Position().at(Trim(values={"V": 10.0}, unknown=("u",)))
    fit = match(start, target, norm="quadratic")
    assert fit["a"].value == pytest.approx(0.12, rel=1e-5)  # 2 a V = 2.4
    assert fit["u_trim"].value == pytest.approx(8.0, rel=1e-5)  # a V² / b


@pytest.mark.parametrize("value", [[0.1, 0.2], "x", None, {}])
def test_a_condition_that_is_no_number_is_refused_by_name(value):
    with pytest.raises(ValueError, match=r"trim: theta = .* is no number; give one total value"):
        Swing().at({"theta": value})
