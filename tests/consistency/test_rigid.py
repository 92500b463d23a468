"""Kinematics of rigid bodies, against rotation matrices and cross products."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from casid.consistency.measured import Flight
from casid.consistency.rigid import lever_of, terms_of


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
