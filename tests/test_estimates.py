"""Tables of parameters and constraints: bounds, prices, errors."""

import numpy as np

from casid import Constraint, Model, Rows, Scalar, parameter
from casid.estimates import at_bounds, constraint_table, on_bounds, parameter_table
from casid.free import free_parameters


class Lag(Model):
    states = ("x",)
    inputs = ("u",)
    outputs = ("x",)
    a: Scalar = parameter(default=-1.0, lower=-5.0, upper=0.0, unit="1/s")
    b: Scalar = parameter(default=2.0, unit="-")
    c: Scalar = parameter(default=0.5, lower=0.0, upper=1.0, unit="-")

    def A(self) -> Rows:
        return [[self.a]]

    def B(self) -> Rows:
        return [[self.b * self.c]]


def test_a_parameter_that_a_solver_stops_short_of_its_bound_is_on_it():
    free = free_parameters(Lag(), bounds={"a": (-1.0, 0.25), "b": (-3.0, 3.0)}, fixed=("c",))
    unit = free.scale[free.index]
    short = np.array([0.25, -3.0]) + np.array([-1e-5, 1e-5]) * unit
    held = np.array([-4.0, 2.0]) / unit
    np.testing.assert_array_equal(on_bounds(free, short, held), [0.25, -3.0])
    # no price, a price of the other side, or further off than any solver stops
    for price in (0 * held, -held):
        np.testing.assert_array_equal(on_bounds(free, short, price), short)
    far = np.array([0.25, -3.0]) + np.array([-1e-3, 1e-3]) * unit
    np.testing.assert_array_equal(on_bounds(free, far, held), far)


def test_a_parameter_whose_way_to_the_bound_the_data_feel_is_not_on_it():
    free = free_parameters(Lag(b=10.0), bounds={"b": (0.0, 1e6)}, fixed=("c",))
    values, prices, asked = np.array([-5.0, 8.0]), np.array([0.7, 1e-3]), []

    def felt():
        asked.append(1)
        return np.array([0.1, 0.02])

    np.testing.assert_array_equal(on_bounds(free, values, prices, felt), values)
    assert asked  # b is nearer to zero, in the scale of such bounds, than a solver stops
    np.testing.assert_array_equal(on_bounds(free, values, prices), [-5, 0])
    unfelt = on_bounds(free, values, prices, lambda: np.array([0.1, np.inf]))
    np.testing.assert_array_equal(unfelt, [-5, 0])
    a, b, _ = parameter_table(free, np.array([-5.0, 0.05]), prices, insensitivity=felt())
    assert (a.active, b.active, b.multiplier) == (True, False, 0.0)
    held = at_bounds(free, np.array([-5.0, 1e-4]), felt())
    np.testing.assert_array_equal(held, [True, True])


def test_the_table_tells_bounds_fixed_parameters_and_the_guess():
    free = free_parameters(Lag(c=0.25), fixed=("c",))
    values, prices, errors = np.array([[-5.0, 3.0], [0.7, 1e-9], [0.1, 0.2]])
    a, b, c = parameter_table(free, values, prices, errors)
    assert (a.name, a.value, a.guess, a.lower, a.upper, a.unit) == ("a", -5, -1, -5, 0, "1/s")
    assert a.active
    assert a.multiplier == 0.7
    assert not b.active
    assert b.multiplier == 0.0  # rounding off the bounds is no price
    assert (b.std_error, b.fixed) == (0.2, False)
    assert (c.value, c.fixed, c.active, c.std_error) == (0.25, True, False, 0.0)
    assert all(np.isnan(row.insensitivity) for row in (a, b, c))


def test_without_a_noise_model_standard_errors_are_nan():
    rows = parameter_table(free_parameters(Lag()), np.zeros(3), np.zeros(3), guess=Lag(a=-2.0))
    assert all(np.isnan(row.std_error) for row in rows)
    assert rows[0].guess == -2.0


class Ruled(Lag):
    def constraints(self) -> tuple[Constraint, ...]:
        return (
            Constraint("upper", self.b + self.c, -np.inf, 2.5),
            Constraint("free", self.b - self.c, 0.0, 9.0),
            Constraint("tie", self.a + self.b, 1.0, 1.0),
        )


def test_constraints_are_active_on_either_bound_and_carry_their_price_then():
    upper, free, tie = constraint_table(Ruled(), np.array([-0.3, 0.2, 0.1]), np.ones(3))
    assert (upper.value, upper.active, upper.multiplier) == (2.5, True, -0.3)
    assert (free.value, free.active, free.multiplier) == (1.5, False, 0.0)
    assert (tie.value, tie.active, tie.multiplier) == (1.0, True, 0.1)
    (lower,) = (
        row for row in constraint_table(Ruled(b=0.5), np.ones(3), np.ones(3)) if row.name == "free"
    )
    assert (lower.value, lower.active, lower.multiplier) == (0.0, True, 1.0)


def test_what_follows_from_a_parameter_on_its_bound_has_no_error_of_its_own():
    values, errors = np.array([-1.0, 2.0, 0.5]), np.array([1e-16, 1e-17, 0.1])
    at_bound = free_parameters(Ruled(), bounds={"a": (-1.0, 0.0)})
    a, b, c = parameter_table(at_bound, values, np.zeros(3), errors, cramer_rao=errors)
    assert (a.active, b.active, c.active) == (True, False, False)
    for row in (a, b, c):  # a + b = 1, and b + c at its largest
        assert np.isnan([row.std_error, row.cramer_rao]).all()
    loose = Ruled(c=0.25)  # b + c has room
    rows = parameter_table(free_parameters(loose), loose.vector(), np.zeros(3), errors)
    np.testing.assert_array_equal([row.std_error for row in rows], errors)
