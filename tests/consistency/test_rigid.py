"""Kinematics of rigid bodies, against rotation matrices and cross products."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from casid.consistency.measured import Flight
from casid.consistency.rigid import Sides, lever_of, terms_of, tilted

STATES, SENSED = ("phi", "theta", "psi", "u", "v", "w"), ("p", "q", "r", "ax", "ay", "az")


def turning(begin=0.0):
    """Attitude (N, 3) as roll, pitch and heading, velocity (N, 3) in the body, of time t (N,)."""
    t = begin + 1e-3 * np.arange(2001)
    roll, pitch = 0.7 * np.sin(2 * t) + 0.2, 0.5 * np.cos(1.3 * t)
    attitude = np.column_stack([roll, pitch, 0.4 * t**2 - t])
    return t, attitude, np.column_stack([30 + np.sin(t), 3 * np.cos(2 * t), t - 2])


@pytest.mark.parametrize("equation", ["phi", "theta", "psi", "u", "v", "w"])
def test_rates_and_forces_move_attitude_and_velocity_as_a_rigid_body(equation):
    t, attitude, velocity = turning()
    R = Rotation.from_euler("ZYX", attitude[:, ::-1]).as_matrix()  # to the earth's axes
    S = np.einsum("nji,njk->nik", R, np.gradient(R, t, axis=0))  # RᵀR', the rates' cross product
    rates = np.column_stack([S[:, 2, 1], S[:, 0, 2], S[:, 1, 0]])
    moved = np.gradient(np.einsum("nij,nj->ni", R, velocity), t, axis=0) - [0, 0, 9.80665]
    forces = np.einsum("nji,nj->ni", R, moved)  # down is the third axis
    found = dict(zip(("p", "q", "r", "ax", "ay", "az"), np.hstack([rates, forces]).T, strict=True))
    states = np.hstack([attitude, velocity])
    values = dict(zip(("phi", "theta", "psi", "u", "v", "w"), states.T, strict=True))
    factors, rest = terms_of(equation, Flight(t[1], 0, values | found))
    slope = rest + sum(factor * found[name] for name, factor in factors.items())
    true = np.gradient(values[equation], t)
    # Central differences of 1 ms: 1e-6 of third derivatives of up to some hundred, over six.
    np.testing.assert_allclose(slope[2:-2], true[2:-2], atol=3e-4)


def test_instruments_beside_the_centre_of_gravity_feel_the_turn():
    rng = np.random.default_rng(4)
    omega, change, place = rng.standard_normal((3, 5, 3))
    moved = {name: (omega[:, k], change[:, k]) for k, name in enumerate(("p", "q", "r"))}
    felt = lever_of(moved) @ place[0]
    expected = np.cross(change, place[0]) + np.cross(omega, np.cross(omega, place[0]))
    np.testing.assert_allclose(felt, expected.T, atol=1e-12)


CLOCKS = {"theta": 0.05, "psi": -0.03, "u": 0.08, "v": 0.08, "w": 0.08}
SKEWS = dict(zip(SENSED, (0.02, -0.04, 0.03, 0.01, -0.02, 0.04), strict=True))
OWNED = dict(zip(SENSED, STATES, strict=True))


def sensed(begin):
    """What rates (N, 3) and accelerometers (N, 3) of `turning` measure."""
    t, attitude, velocity = turning(begin)
    R = Rotation.from_euler("ZYX", attitude[:, ::-1]).as_matrix()
    S = np.einsum("nji,njk->nik", R, np.gradient(R, t, axis=0))
    moved = np.gradient(np.einsum("nij,nj->ni", R, velocity), t, axis=0) - [0, 0, 9.80665]
    rates = np.column_stack([S[:, 2, 1], S[:, 0, 2], S[:, 1, 0]])
    return np.hstack([rates, np.einsum("nji,nj->ni", R, moved)])


def late_flight():
    """A flight whose states have `CLOCKS`, and rates and forces `SKEWS` against what they move."""
    values = {}
    for k, name in enumerate(STATES):
        _, attitude, velocity = turning(-CLOCKS.get(name, 0.0))
        values[name] = np.hstack([attitude, velocity])[:, k]
    for k, name in enumerate(SENSED):
        values[name] = sensed(-SKEWS[name] - CLOCKS.get(OWNED[name], 0.0))[:, k]
    return Flight(1e-3, 0, values)


def sides(flight, equations, clocks, table):
    read = (*SENSED, "phi", "theta")
    pieces = {name: CubicSpline(flight.t, flight.values[name]).c for name in read}
    return Sides(flight, pieces, table, equations, clocks, np.zeros(3))


@pytest.mark.parametrize("equation", STATES)
def test_every_term_is_taken_at_the_time_of_the_left_hand_side(equation):
    flight = late_flight()
    table = {name: np.array([1.0, 0.0, skew]) for name, skew in SKEWS.items()}
    whole = sides(flight, STATES, np.array([0.05, -0.03, 0.08]), table)
    f = [whole.of(each)[1] for each in STATES][STATES.index(equation)]  # of clocks of their own
    inside = slice(200, -200)  # all clocks and skews read within the flight
    true = np.gradient(flight.values[equation], flight.t)
    np.testing.assert_allclose(f[inside], true[inside], atol=5e-4)


@pytest.mark.parametrize("equation", STATES)
def test_slopes_are_those_of_differences(equation):
    flight, clocks = late_flight(), np.array([0.05, -0.03, 0.08])
    table = {name: np.array([1.1, 0.2, skew]) for name, skew in SKEWS.items()}
    slopes, _ = sides(flight, STATES, clocks, table).of(equation)

    def side(name="", k=0, by=0.0):
        moved = {
            each: row + by * (np.arange(3) == k) * (each == name) for each, row in table.items()
        }
        return sides(flight, STATES, clocks + by * (np.arange(3) == k) * (not name), moved).of(
            equation
        )[1]

    h = 1e-4
    own = [name for name in SENSED if np.ptp(side(name, 1, h) - side()) + abs(
        (side(name, 1, h) - side()).mean()) > 0]  # fmt: skip
    wanted = [(name, k) for name in own for k in range(3)] + [("", k) for k in range(3)]
    found = [(side(*one, h) - side(*one, -h)) / (2 * h) for one in wanted]
    np.testing.assert_allclose(
        np.array(slopes[: len(wanted)])[:, 200:-200], np.array(found)[:, 200:-200], atol=1e-3
    )


@pytest.mark.parametrize("equation", STATES)
def test_slopes_by_what_stands_in_products_are_those_of_differences(equation):
    rng, h = np.random.default_rng(7), 1e-6
    known = {name: 0.4 * rng.standard_normal(9) for name in (*SENSED, *STATES)}

    def side(name, by):
        at = known | {name: known[name] + by}
        factors, rest = terms_of(equation, Flight(0.1, 0, at))
        return rest + sum(one * known.get(each) for each, one in factors.items())

    slopes = tilted(equation, known)
    for name in STATES:
        found = slopes.get(name, np.zeros(9))
        wanted = (side(name, h) - side(name, -h)) / (2 * h)
        np.testing.assert_allclose(found, wanted, atol=1e-8, err_msg=name)


def test_without_heading_yaw_rate_is_read_against_bank():
    flight, equations = late_flight(), ("phi", "theta")
    table = {name: np.array([1.0, 0.0, skew]) for name, skew in SKEWS.items()}
    table["r"] = table["r"] + [0.0, 0.0, -0.03]  # against ψ, that is this much late
    f = sides(flight, equations, np.array([0.05, 9.0, 9.0]), table).of("theta")[1]
    true = np.gradient(flight.values["theta"], flight.t)
    np.testing.assert_allclose(f[200:-200], true[200:-200], atol=5e-4)
