"""Trims completed by the balance of the equations, against closed forms."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from truths.swing import Swing
from truths.twofold import Twofold

from casid import NonlinearModel, Scalar, Trim, parameter
from casid.nonlinear.balance import Balance, balanced


class Sinking(NonlinearModel):
    """u' = thr - c u², w' = g - k u w - e w²: balance and its slope have closed forms."""

    states, inputs, outputs = ("x", "u", "w"), ("thr",), ("u",)

    k: Scalar = parameter(default=0.06, lower=0.0, upper=1.0, unit="1/m")
    e: Scalar = parameter(default=0.2, lower=-1.0, upper=1.0, unit="1/m")
    c: Scalar = parameter(default=0.002, lower=0.0, upper=1.0, unit="1/m")
    g: float = 9.80665

    def derivatives(self, x, u):
        sink = self.g - self.k * x.u * x.w - self.e * x.w**2
        return [x.u, u.thr - self.c * x.u**2, sink]

    def reference(self):
        return {"u": 30.0, "w": 3.0, "thr": 1.8}


def level(V, c=0.002):
    return Trim(name=f"{V:g} m/s", values={"u": V, "thr": c * V**2}, speed=V)


@pytest.mark.parametrize("V", [15.0, 30.0, 45.0])
def test_what_a_trim_does_not_name_is_balanced(V):
    model = Sinking()
    rest = balanced(model, level(V))
    k, e, g = model.k, model.e, model.g
    root = np.sqrt((k * V) ** 2 + 4 * e * g)
    assert rest.doubt == ""
    assert rest.found == {"w": pytest.approx((root - k * V) / (2 * e), rel=1e-8)}
    assert rest.trim.values == level(V).values | rest.found  # x moves on, as a position does
    assert np.linalg.eigvals(model.at(rest.trim).system().A).min() == pytest.approx(-root, rel=1e-8)


def test_what_is_named_gives_way_by_what_balance_needs():
    rest = balanced(Sinking(), Trim(values={"u": 30.0, "thr": 1.81}))
    assert rest.doubt == ""
    assert rest.moved == {"thr": pytest.approx(-0.01)}
    w = (np.sqrt(1.8**2 + 4 * 0.2 * 9.80665) - 1.8) / 0.4
    assert rest.found["w"] == pytest.approx(w)
    far = balanced(Sinking(), Trim(values={"u": 30.0, "thr": 1.9}, name="cruise"))
    assert far.doubt == f"at cruise with w = {w:.4g}: thr moves by -0.1 from the 1.9 given"


class Shared(NonlinearModel):
    """Two sticks and a velocity share a balance that the trim is not quite in."""

    states, inputs, outputs = ("u", "v", "lag"), ("a", "b"), ("u",)

    Yv: Scalar = parameter(default=-0.1, lower=-1.0, upper=0.0, unit="1/s")

    def derivatives(self, x, u):
        return [u.a - x.lag, u.a + 2 * u.b + self.Yv * x.v - 1.0, u.a - x.lag]


def test_moves_are_least_with_velocities_by_the_airspeed():
    given = {"u": 50.0, "v": 1.0, "a": 0.57, "b": 0.29}  # out of balance by 0.05
    rest = balanced(Shared(), Trim(values=given))
    slopes, size = np.array([-0.1, 1.0, 2.0]), np.array([50.0, 1.0, 1.0])
    least = -0.05 * slopes * size**2 / np.sum((slopes * size) ** 2)
    np.testing.assert_allclose([rest.moved[name] for name in ("v", "a", "b")], least, rtol=1e-6)
    assert rest.found["lag"] == pytest.approx(given["a"] + least[1])
    assert rest.doubt == ""


def test_a_condition_in_balance_is_kept():
    whole = balanced(Sinking(), level(20.0)).trim
    assert balanced(Sinking(), whole) == Balance(whole)


def test_the_nearest_balance_is_on_the_line_of_least_moves():
    model = Swing(M=4.0, Mlon=5.0)
    found = balanced(model, Trim(values={"theta": 0.4, "lon": 0.3, "q": 0.02})).trim.values
    theta, lon = found["theta"], found["lon"]
    assert found["q"] == pytest.approx(0.0, abs=1e-9)
    assert 5.0 * np.cos(theta) * lon == pytest.approx(4.0 * np.sin(theta), abs=1e-9)
    along = np.arctan(5.0 * 0.01 * np.arange(20, 50) / 4.0)  # balances at sticks of 0.2 to 0.49
    distance = np.hypot(along - 0.4, 0.01 * np.arange(20, 50) - 0.3)
    assert np.hypot(theta - 0.4, lon - 0.3) <= distance.min() + 1e-3
    held = balanced(model, Trim(values={"theta": 0.4, "lon": 0.3}), held=("theta",)).trim.values
    assert held["theta"] == 0.4
    assert held["lon"] == pytest.approx(0.8 * np.tan(0.4))


def test_distances_from_a_balance_are_shares_of_values_above_one():
    model, given = Swing(M=4.0, Mlon=5.0), np.array([1.1, 2.0])
    found = balanced(model, Trim(values={"theta": given[0], "lon": given[1]})).trim.values
    theta = np.linspace(1.0, 1.4, 40_001)
    line = np.array([theta, 0.8 * np.tan(theta)])  # the balances
    away = np.linalg.norm((line.T - given) / np.maximum(given, 1.0), axis=1)
    # each step is the shortest to where the slope has the balance: off in second order
    assert found["theta"] == pytest.approx(theta[np.argmin(away)], abs=0.003)


def test_unknowns_of_a_trim_start_at_its_values():
    rest = balanced(Sinking(), Trim(values={"u": 30.0, "w": -15.0, "thr": 1.8}, unknown=("w",)))
    root = np.sqrt(1.8**2 + 4 * 0.2 * 9.80665)
    assert (rest.doubt, rest.trim.unknown) == ("", ())
    assert rest.trim.values["w"] == pytest.approx((-root - 1.8) / 0.4, rel=1e-8)


def test_no_balance_is_told_with_what_stays():
    """g - k u w + |e| w² is least g - (k u)² / (4 |e|), above zero at 10 m/s."""
    stays = 9.80665 - 0.6**2 / 0.8
    rest = balanced(Sinking(e=-0.2), level(10.0))
    assert rest.doubt == f"at 10 m/s with w = 1.5: d/dt w = {stays:.3g} instead of 0"


def test_more_unknowns_than_equations_are_told():
    doubt = balanced(Sinking(), Trim(values={}, name="cruise")).doubt
    assert doubt.startswith("at cruise with u = ")
    assert doubt.endswith("its equations determine 2 of these 3 only")


class Rooted(NonlinearModel):
    """w' = thr - sqrt(w), which the reference leaves undefined for a trim of no w."""

    states, inputs, outputs = ("w", "u"), ("thr",), ("w",)

    k: Scalar = parameter(default=1.0, lower=0.0, upper=2.0, unit="-")

    def derivatives(self, x, u):
        return [u.thr - self.k * ca.sqrt(x.w - x.u), -x.u]

    def reference(self):
        return {"w": 1.0}


def test_equations_without_values_are_told():
    rest = balanced(Rooted(), Trim(values={"u": 2.0}))
    assert rest.doubt == "at a trim: dx/dt is not finite"


@pytest.mark.parametrize("V", [15.0, 45.0])
def test_a_balance_moves_with_the_parameters_as_its_closed_form(V):
    model = Sinking()
    rest = balanced(model, level(V))
    k, e, g = model.k, model.e, model.g
    root = np.sqrt((k * V) ** 2 + 4 * e * g)
    by_k, by_e = (k * V**2 / root - V) / (2 * e), g / (e * root) - (root - k * V) / (2 * e**2)
    moves = rest.trim.moves
    assert {name: origin for name, (_, origin) in moves["w"].items()} == {"k": k, "e": e}
    assert [slope for slope, _ in moves["w"].values()] == pytest.approx([by_k, by_e], rel=1e-6)
    assert moves["thr"]["c"][0] == pytest.approx(V**2, rel=1e-6)  # it gives way
    assert set(moves) == {"w", "thr"}


def test_moves_with_the_parameters_are_those_of_balancing_anew():
    names, trim = ("v", "a", "b", "lag"), Trim(values={"u": 50.0, "v": 1.0, "a": 0.57, "b": 0.29})
    ends = [balanced(replace(Shared(), Yv=Yv), trim).trim.values for Yv in (-0.1001, -0.0999)]
    below, above = ([each[name] for name in names] for each in ends)
    moves = balanced(Shared(), trim).trim.moves
    moved = [moves[name]["Yv"][0] for name in names]
    np.testing.assert_allclose(moved, (np.array(above) - below) / 2e-4, rtol=1e-4)


class Curved(NonlinearModel):
    """One balance in two values that are both named, not quite in it, and bent in one."""

    states, inputs, outputs = ("u",), ("a", "b"), ("u",)

    k: Scalar = parameter(default=1.0, lower=0.0, upper=5.0, unit="-")

    def derivatives(self, x, u):
        return [self.k * u.a**2 + u.b - 0.02 * x.u]


def test_a_bent_balance_moves_as_balancing_anew():
    trim = Trim(values={"u": 50.0, "a": 0.5, "b": 0.45})  # out of balance by 0.3
    ends = [balanced(replace(Curved(), k=k), trim).trim.values for k in (0.9999, 1.0001)]
    moves = balanced(Curved(), trim).trim.moves
    for name in ("a", "b"):
        expected = (ends[1][name] - ends[0][name]) / 2e-4
        assert moves[name]["k"][0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.second
def test_a_linearisation_moves_with_its_condition():
    model, V = Sinking(), 20.0
    linear = model.at(balanced(model, level(V)).trim)
    for name, step in (("k", 1e-6), ("e", 1e-6), ("c", 1e-8)):
        value, ends = getattr(model, name), []
        for end in (value - step, value + step):
            other = replace(model, **{name: end})
            anew = other.at(balanced(other, level(V)).trim).system()
            kept = replace(linear, **{name: end}).system()
            np.testing.assert_allclose(kept.A, anew.A, rtol=1e-9)
            ends.append(kept.A)
        assert np.abs(ends[1] - ends[0]).max() > 0


def test_a_condition_that_moves_is_another_one():
    moving = balanced(Sinking(), level(20.0)).trim
    held = replace(moving, moves={})
    assert moving != held
    assert replace(moving, moves=dict(moving.moves)) == moving
    ahead = [replace(Sinking().at(each), k=0.07).system().A[2, 2] for each in (moving, held)]
    assert abs(ahead[0] - ahead[1]) > 1e-3


CRUISE = Trim(name="cruise", values={"V": 10.0, "e": 1.0})


def test_of_several_balances_that_is_taken_in_which_records_began():
    began = np.array([[14.0, 1.1], [10.2, -0.9]])  # of two records: the slower is the nearer
    rest = balanced(Twofold(), CRUISE, flown=began)
    assert (rest.doubt, rest.found) == ("", {"w": pytest.approx(-1.0)})
    faster = balanced(Twofold(), CRUISE, flown=began[:1])
    assert (faster.doubt, faster.found) == ("", {"w": pytest.approx(1.0)})


@pytest.mark.parametrize("began", [None, np.array([[10.0, 0.2]])])
def test_several_balances_none_of_which_is_clearly_nearest_are_told(began):
    rest = balanced(Twofold(), CRUISE, flown=began)
    assert rest.found == {"w": pytest.approx(1.0)}
    assert rest.doubt == "at cruise with w = 1: it also balances with w = -1"


def test_a_reference_in_balance_is_not_taken_where_another_balance_was_flown():
    class Other(Twofold):
        """Written down at the balance that is not flown."""

        def reference(self):
            return {"V": 10.0, "w": 1.0, "e": 1.0}

    rest = balanced(Other(), CRUISE, flown=np.array([[10.0, -0.95]]))
    assert (rest.doubt, rest.found) == ("", {"w": pytest.approx(-1.0)})
    assert balanced(Other(), CRUISE).found == {"w": pytest.approx(1.0)}


def test_where_a_record_began_without_values_the_reference_is_the_start():
    trim = Trim(values={"u": 0.0, "thr": 2.0})
    rest = balanced(Rooted(), trim, flown=np.array([[-50.0, 0.0]]))
    assert (rest.doubt, rest.found) == ("", {"w": pytest.approx(4.0)})


def test_an_input_called_u_gives_way_as_another_does():
    class Stick(NonlinearModel):
        """V' = d (10 - V) + u - 1 with a stick u."""

        states, inputs, outputs = ("V",), ("u",), ("V",)

        d: Scalar = parameter(default=0.7, lower=0.01, upper=9.0, unit="1/s")

        def derivatives(self, x, u):
            return [self.d * (10.0 - x.V) + u.u - 1.0]

    rest = balanced(Stick(), Trim(values={"V": 10.01, "u": 1.0}))
    assert (rest.doubt, rest.moved) == ("", {"u": pytest.approx(0.007)})
