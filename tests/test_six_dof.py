"""The six-degree-of-freedom structure against the nonlinear rigid-body equations."""

from dataclasses import replace

import numpy as np
import pytest

from casid.free import free_parameters
from models.six_dof import SixDof

RNG = np.random.default_rng(11)
LEVEL = SixDof(U0=41.15)
TURN = SixDof(
    U0=40.2, V0=2.7, W0=2.1, P0=-0.004, Q0=0.011, R0=0.09, phi0=0.35, theta0=0.12, g=9.81
)  # fmt: skip


def anyhow(trim):
    """A model with every parameter at random inside its bounds."""
    free = free_parameters(trim)
    share = RNG.uniform(0.1, 0.9, len(free.lower))
    return trim.with_vector(free.lower + share * (free.upper - free.lower))


def derivatives(m):
    """Rows X Y Z L M N over columns u v w p q r and col lat lon ped, read by name."""
    rows, states = "XYZLMN", "uvwpqr"
    stability = [[getattr(m, row + column) for column in states] for row in rows]
    control = [[getattr(m, row + stick) for stick in SixDof.inputs] for row in rows]
    return np.array(stability), np.array(control)


def rigid_body(m, x, stick):
    """dx/dt and specific forces, nonlinear but for the derivatives, which are linear by definition.

    The trim's own forces and moments are what holds u, v, w, p, q, r steady.
    """
    u, v, w, p, q, r, phi, theta = x
    x0 = np.array([m.U0, m.V0, m.W0, m.P0, m.Q0, m.R0])
    stability, control = derivatives(m)
    aero = stability @ (x[:6] - x0) + control @ stick
    ax, ay, az = aero[:3] + trim_forces(m)
    return np.array([
        r * v - q * w - m.g * np.sin(theta) + ax,
        p * w - r * u + m.g * np.sin(phi) * np.cos(theta) + ay,
        q * u - p * v + m.g * np.cos(phi) * np.cos(theta) + az,
        *aero[3:],
        p + (q * np.sin(phi) + r * np.cos(phi)) * np.tan(theta),
        q * np.cos(phi) - r * np.sin(phi),
    ]), np.array([ax, ay, az])  # fmt: skip


def trim_forces(m):
    return np.array([
        m.Q0 * m.W0 - m.R0 * m.V0 + m.g * np.sin(m.theta0),
        m.R0 * m.U0 - m.P0 * m.W0 - m.g * np.sin(m.phi0) * np.cos(m.theta0),
        m.P0 * m.V0 - m.Q0 * m.U0 - m.g * np.cos(m.phi0) * np.cos(m.theta0),
    ])  # fmt: skip


def numerical(m):
    """Central differences of state derivative and outputs about the trim: A, B, C, D."""
    trim = np.array([m.U0, m.V0, m.W0, m.P0, m.Q0, m.R0, m.phi0, m.theta0, 0, 0, 0, 0])

    def both(z):
        rate, force = rigid_body(m, z[:8], z[8:])
        return np.concatenate([rate, force, z[3:8]])

    h = 1e-4
    J = np.column_stack([(both(trim + h * e) - both(trim - h * e)) / (2 * h) for e in np.eye(12)])
    return J[:8, :8], J[:8, 8:], J[8:, :8], J[8:, 8:]


@pytest.mark.parametrize("trim", [LEVEL, TURN], ids=["level", "turn"])
def test_it_is_the_linearisation_of_the_rigid_body_equations(trim):
    model = anyhow(trim)
    system = model.system()
    for letter, expected in zip("ABCD", numerical(model), strict=True):
        # Cubic terms h² g/6 = 2e-8 and rounding 1e-16 · 1e2 / h = 1e-10.
        np.testing.assert_allclose(getattr(system, letter), expected, atol=1e-7, err_msg=letter)


def test_the_trim_is_steady():
    x0 = np.array([TURN.U0, TURN.V0, TURN.W0, TURN.P0, TURN.Q0, TURN.R0, TURN.phi0, TURN.theta0])
    rates, _ = rigid_body(TURN, x0, np.zeros(4))
    np.testing.assert_allclose(rates[:6], 0, atol=1e-12)


@pytest.mark.parametrize("trim", [LEVEL, TURN], ids=["level", "turn"])
def test_specific_forces_are_accelerations_without_gravity_and_frame_rotation(trim):
    m = anyhow(trim)
    s = m.system()
    x, u = RNG.standard_normal(8), RNG.standard_normal(4)
    du, dv, dw = (s.A @ x + s.B @ u)[:3]
    vel, rate, phi, theta = x[:3], x[3:6], x[6], x[7]
    trim_v, trim_w = np.array([m.U0, m.V0, m.W0]), np.array([m.P0, m.Q0, m.R0])
    turning = np.cross(trim_w, vel) + np.cross(rate, trim_v)
    cphi, sphi, cth, sth = np.cos(m.phi0), np.sin(m.phi0), np.cos(m.theta0), np.sin(m.theta0)
    gravity = m.g * np.array([
        -cth * theta, cphi * cth * phi - sphi * sth * theta, -sphi * cth * phi - cphi * sth * theta
    ])  # fmt: skip
    expected = np.array([du, dv, dw]) + turning - gravity
    np.testing.assert_allclose((s.C @ x + s.D @ u)[:3], expected, atol=1e-10)


def test_it_has_the_derivatives_delays_and_outputs_of_the_paper():
    names = SixDof.parameter_names()
    assert len(names) == 36 + 24 + 4
    assert names[-4:] == ("tau_col", "tau_lat", "tau_lon", "tau_ped")
    model = replace(LEVEL, tau_lat=0.07, tau_ped=0.01)
    np.testing.assert_array_equal(model.system().delay, [0.05, 0.07, 0.05, 0.01])
    assert model.system().outputs == ("ax", "ay", "az", "p", "q", "r", "phi", "theta")
    for info in SixDof.infos().values():
        assert np.isfinite([info.lower, info.upper]).all()


def test_every_parameter_reaches_the_matrices_where_its_name_says():
    base = LEVEL.system()
    for name in SixDof.parameter_names()[:60]:
        moved = replace(LEVEL, **{name: getattr(LEVEL, name) + 0.5}).system()
        row = ["X", "Y", "Z", "L", "M", "N"].index(name[0])
        column = name[1:]
        change = (moved.A - base.A, moved.B - base.B)
        expected = (np.zeros((8, 8)), np.zeros((8, 4)))
        if column in SixDof.inputs:
            expected[1][row, SixDof.inputs.index(column)] = 0.5
        else:
            expected[0][row, SixDof.states.index(column)] = 0.5
        for a, b in zip(change, expected, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-12)
