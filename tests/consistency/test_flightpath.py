"""Kinematics of rigid bodies and what filters them, against closed forms and rotation matrices."""

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from casid.consistency.flightpath import _integral, _lever, _steady_gain, _terms, reconstruct
from casid.consistency.measured import Flight


def test_running_integrals_are_exact_for_straight_lines_and_of_fourth_order_inside():
    t = np.linspace(0.0, 2.0, 41)
    line = _integral(np.column_stack([np.ones(41), 3 - 2 * t]), 0.05)
    np.testing.assert_allclose(line, np.column_stack([t, 3 * t - t**2]), atol=1e-13)
    errors = []
    for count in (41, 81):
        t = np.linspace(0.0, 2.0, count)
        found = _integral(np.sin(3 * t)[:, None], t[1])[:, 0]
        inside = found - found[1] - (np.cos(3 * t[1]) - np.cos(3 * t)) / 3
        errors.append(np.abs(inside[1:-1]).max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.2)


def turning():
    """Attitude (N, 3) as roll, pitch and heading, velocity (N, 3) in the body, of time t (N,)."""
    t = 1e-3 * np.arange(2001)
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
    factors, rest = _terms(equation, Flight(t[1], 0, values | found))
    slope = rest + sum(factor * found[name] for name, factor in factors.items())
    true = np.gradient(values[equation], t)
    # Central differences of 1 ms: 1e-6 of third derivatives of up to some hundred, over six.
    np.testing.assert_allclose(slope[2:-2], true[2:-2], atol=3e-4)


def test_instruments_beside_the_centre_of_gravity_feel_the_turn():
    rng = np.random.default_rng(4)
    omega, change, place = rng.standard_normal((3, 5, 3))
    moved = {name: (omega[:, k], change[:, k]) for k, name in enumerate(("p", "q", "r"))}
    felt = _lever(moved) @ place[0]
    expected = np.cross(change, place[0]) + np.cross(omega, np.cross(omega, place[0]))
    np.testing.assert_allclose(felt, expected.T, atol=1e-12)
    assert _lever({"p": moved["p"]}) is None


@pytest.mark.parametrize("ratio", [1e-4, 0.3, 20.0])
def test_the_least_gain_is_that_of_a_filter_of_a_random_walk(ratio):
    one = np.ones((1, 1))
    (P,) = scipy.linalg.solve_discrete_are(one, one, ratio * one, one).ravel()
    assert _steady_gain(ratio) == pytest.approx(P / (P + 1), rel=1e-9)


def test_what_flights_do_not_tell_stays_where_it_was_expected():
    # A rate that stands still tells of its bias alone, and nothing of the accelerometers' place.
    attitude = 1e-3 * np.random.default_rng(2).standard_normal(500)
    found = reconstruct([Flight(0.02, 0, {"p": np.zeros(500), "phi": attitude})], ["phi"])
    assert found.channels == ("p",)
    (gain, bias, skew), errors = found.unknowns[0], found.errors[0]
    assert (gain, skew) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert (errors[0], errors[2]) == pytest.approx((1.0, 0.1), rel=1e-3)
    assert abs(bias) < 4 * errors[1] < 0.01
    np.testing.assert_allclose(found.place, 0, atol=1e-6)
    np.testing.assert_allclose(found.place_errors, 10.0, rtol=1e-3)
