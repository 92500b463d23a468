"""Sensors against rigid-body kinematics written in the frequency domain."""

import numpy as np
import pytest

from casid import (
    Model,
    ModelError,
    NonlinearModel,
    Record,
    Rows,
    Scalar,
    Sensor,
    output_error,
    parameter,
)
from models.heave_inflow import HeaveInflow
from models.lateral_directional import LateralDirectional
from models.longitudinal_aero import LongitudinalAero
from models.minimum_complexity import MinimumComplexity
from models.rigid_body import RigidBody
from models.scheduled_hybrid import ScheduledHybrid
from models.scheduled_six_dof import ScheduledSixDof
from models.sensors import Accelerometers
from models.six_dof import SixDof

OMEGA = np.geomspace(0.3, 15.0, 12)
TRIM = {"U0": 40.9, "V0": 2.8, "W0": 2.1, "P0": 0.02, "Q0": -0.03, "R0": 0.1, "theta0": 0.05}


class Boom(Accelerometers, SixDof):
    """Accelerometers somewhere."""


class LateRoll(SixDof):
    """Roll angle late, pitch rate with a scale."""

    late_outputs = ("phi",)
    tau_phi: Scalar = parameter(default=0.06, lower=0.002, upper=0.2, unit="s")

    def sensors(self):
        return {"phi": Sensor(delay=self.tau_phi), "q": Sensor(scale=1.1)}


class Vane(Model):
    """Heave and pitch with an angle-of-attack vane on a boom."""

    states = ("w", "q")
    inputs = ("lon",)
    outputs = ("alpha", "w")
    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.Zw, 40.0], [-0.02, -1.0]]

    def B(self) -> Rows:
        return [[-5.0], [8.0]]

    def C(self) -> Rows:
        return [[1 / 40.0, 0], [1, 0]]

    def sensors(self):
        return {"alpha": Sensor(x=3.0, airspeed=40.0), "w": Sensor(x=3.0)}


def spread(structure):
    """A model none of whose derivatives is zero."""
    rng = np.random.default_rng(3)
    values = structure(**TRIM)
    return values.with_vector(values.vector() + 0.1 * rng.uniform(0.2, 1.0, len(values.vector())))


def test_specific_forces_away_from_the_centre_are_those_of_a_rigid_body():
    model = spread(Boom)
    r = np.array([model.x_acc, model.y_acc, model.z_acc])
    assert np.abs(r).min() > 0.01
    base = SixDof(**TRIM)
    base = base.with_vector(model.vector()[: len(base.vector())])
    assert base.Lp == model.Lp
    G, at = (each.system().response(OMEGA) for each in (base, model))
    rates, trim = np.moveaxis(G[:, 3:6], 1, -1), np.array([0.02, -0.03, 0.1])
    turning = 1j * OMEGA[:, None, None] * np.cross(rates, r)
    # The linear part of (W + w) x ((W + w) x r).
    turning += np.cross(trim, np.cross(rates, r)) + np.cross(rates, np.cross(trim, r))
    np.testing.assert_allclose(at[:, :3], G[:, :3] + np.moveaxis(turning, -1, 1), rtol=1e-10)
    np.testing.assert_allclose(at[:, 3:], G[:, 3:], rtol=1e-12)


def test_mixin_gives_a_structure_with_one_specific_force_its_share():
    class Side(Accelerometers, LateralDirectional):
        """Sideways only."""

    model = Side(x_acc=1.5, z_acc=-0.5)
    C, base = model.system().C, LateralDirectional().system()
    # ay_s = ay + r' x - p' z
    expected = base.C[0] + 1.5 * base.A[2] + 0.5 * base.A[1]
    np.testing.assert_allclose(C[0], expected, rtol=1e-12, atol=1e-12)


def test_delay_of_an_output_is_a_delay_in_the_band_and_scale_is_a_factor():
    model = spread(LateRoll)
    assert model.states[-3:] == ("phi_late1", "phi_late2", "phi_late3")
    base = SixDof(**TRIM)
    base = base.with_vector(model.vector()[: len(base.vector())])
    G, at = (each.system().response(OMEGA) for each in (base, model))
    x = (model.tau_phi * OMEGA)[:, None]
    error = np.abs(at[:, 6] / (G[:, 6] * np.exp(-1j * x)) - 1)
    assert (error <= 1.2 * x**6 / 7200 + 1e-9).all()
    np.testing.assert_allclose(at[:, 4], 1.1 * G[:, 4], rtol=1e-10)


def test_vane_on_a_boom_feels_pitch_rate():
    system = Vane().system()
    np.testing.assert_allclose(system.C, [[1 / 40, -3 / 40], [1, -3]])


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"ped": Sensor(x=1.0)}, "no output"),
        ({"phi": Sensor(x=1.0)}, "ax, ay, az"),
        ({"phi": Sensor(delay=0.1)}, "late_outputs"),
        ({"ax": 1.5}, "Sensor"),
        ([("ax", Sensor())], "sensors by output"),
    ],
)
def test_sensor_that_means_nothing_is_refused(found, message):
    class Wrong(SixDof):
        """Sensors as given."""

        def sensors(self):
            return found

    with pytest.raises(ModelError, match=message):
        Wrong().matrices()


@pytest.mark.parametrize("base", ["Vane", "Boomed"])
@pytest.mark.parametrize(
    ("found", "states", "message"),
    [
        ({"alpha": Sensor(x=3.0)}, ("w", "q"), "vane of 'alpha' has a place; give its airspeed"),
        ({"w": Sensor(x=3.0)}, ("w", "s"), "'w' needs the rates p, q or r among the states"),
    ],
)
def test_a_place_that_nothing_turns_and_a_vane_without_airspeed_are_refused(
    base, found, states, message
):
    own = {"Vane": Vane, "Boomed": Boomed}[base]
    methods = {
        "derivatives": lambda self, x, u: [self.Zw * x.w + 40 * x.s - u.lon, x.w - x.s],
        "measurements": lambda _, x, __: [x.w, x.s, x.w, x.w],
    }
    parts = {"states": states, "sensors": lambda _: found}
    parts |= methods if base == "Boomed" and "s" in states else {}
    with pytest.raises(ModelError, match=message):
        type("Wrong", (own,), parts)().matrices()


def test_a_structure_that_does_not_turn_says_how_to_move_the_record_instead():
    class Forward(Accelerometers, HeaveInflow):
        """Heave, the accelerometer somewhere."""

    said = r"'az' needs the rates .* nothing turns in this structure.* a − ω′ × r − ω × \(ω × r\)"
    with pytest.raises(ModelError, match=said):
        Forward().matrices()
    # What it says: an instrument in a body that falls and turns, differentiated twice in space.
    t, r = 1e-3 * np.arange(4000), np.array([1.5, 0.0, -0.4])
    theta, fall = 0.2 * np.sin(2 * t), -0.3 * t**2 + 0.1 * np.sin(3 * t)
    place = np.array([r[0] * np.cos(theta) + r[2] * np.sin(theta),
                      fall - r[0] * np.sin(theta) + r[2] * np.cos(theta)])  # fmt: skip
    away, centre = (
        np.gradient(np.gradient(each, t, axis=-1), t, axis=-1)
        for each in (place, np.array([0 * t, fall]))
    )
    body = np.array([np.sin(theta), np.cos(theta)])  # of z
    felt, wanted = (body * away).sum(axis=0), (body * centre).sum(axis=0)
    q = np.gradient(theta, t)
    moved = felt + r[0] * np.gradient(q, t) + r[2] * q**2
    np.testing.assert_allclose(moved[5:-5], wanted[5:-5], atol=1e-5)
    assert np.abs(felt - wanted).max() > 0.5


@pytest.mark.parametrize("wrong", [{"scale": "1.1"}, {"delay": -0.05}, {"x": np.nan}, {"y": None}])
def test_sensor_of_no_numbers_is_refused_when_it_is_made(wrong):
    with pytest.raises(ModelError, match=rf"Sensor\({next(iter(wrong))}=.*expected"):
        Sensor(**wrong)


def test_late_output_needs_a_delay_and_a_name():
    with pytest.raises(ModelError, match="expected a tuple of outputs"):
        type("Wrong", (SixDof,), {"late_outputs": ("psi",)})
    with pytest.raises(ModelError, match="no delay above 0"):
        type("Wrong", (SixDof,), {"late_outputs": ("phi",)})().matrices()


def test_every_output_may_be_late():
    late = type("Late", (SixDof,), {"late_outputs": SixDof.outputs})
    assert late.states[: len(SixDof.states)] == SixDof.states
    assert len(late.states) > len(SixDof.states)


NONLINEAR = [LongitudinalAero, MinimumComplexity, RigidBody, ScheduledHybrid, ScheduledSixDof]


@pytest.mark.parametrize("structure", NONLINEAR)
def test_nonlinear_structures_feel_a_place_as_rigid_bodies_do(structure):
    boom, plain = type("Boom", (Accelerometers, structure), {}), structure()
    model, place = boom(x_acc=1.5, y_acc=0.4, z_acc=-0.5), np.array([1.5, 0.4, -0.5])
    rng = np.random.default_rng(2)
    x0, u0 = plain.operating_point()
    x = x0 + 0.05 * (1 + np.abs(x0)) * rng.uniform(0.2, 1, len(x0))
    f, h = (part.full().ravel() for part in plain.equations()(x, u0, plain.vector()))
    moved, found = (part.full().ravel() for part in model.equations()(x, u0, model.vector()))
    np.testing.assert_array_equal(moved, f)
    omega, faster = (
        np.array([part[plain.states.index(n)] if n in plain.states else 0.0 for n in "pqr"])
        for part in (x, f)
    )
    expected = np.cross(faster, place) + np.cross(omega, np.cross(omega, place))
    for name, value, at_centre in zip(plain.outputs, found, h, strict=True):
        force = ("ax", "ay", "az").index(name) if name in ("ax", "ay", "az") else None
        off = 0.0 if force is None else expected[force]
        assert value - at_centre == pytest.approx(off, abs=1e-9), name


class Boomed(NonlinearModel):
    """Pitch and heave in total values, measured on a boom."""

    states = ("w", "q")
    inputs = ("lon",)
    outputs = ("az", "q", "w", "alpha")

    Zw: Scalar = parameter(default=-0.6, lower=-3.0, upper=0.0, unit="1/s")
    Mq: Scalar = parameter(default=-1.5, lower=-5.0, upper=0.0, unit="1/s")
    place: Scalar = parameter(default=0.0, lower=-5.0, upper=5.0, unit="m")
    k_q: Scalar = parameter(default=1.0, lower=0.5, upper=1.5, unit="-")

    def derivatives(self, x, u):
        return [self.Zw * x.w + 40 * x.q - 5 * u.lon, -0.02 * x.w + self.Mq * x.q + 8 * u.lon]

    def measurements(self, x, u):
        return [self.Zw * x.w - 5 * u.lon, x.q, x.w, x.w / 40]

    def sensors(self):
        on = Sensor(x=self.place)
        vane = Sensor(x=self.place, airspeed=40.0)
        return {"az": on, "w": on, "alpha": vane, "q": Sensor(scale=self.k_q)}


def test_a_nonlinear_structure_that_is_linear_measures_as_a_linear_one():
    class Linear(Model):
        states, inputs, outputs = Boomed.states, Boomed.inputs, Boomed.outputs

        def A(self):
            return [[-0.6, 40], [-0.02, -1.5]]

        def B(self):
            return [[-5], [8]]

        def C(self):
            return [[-0.6, 0], [0, 1], [1, 0], [1 / 40, 0]]

        def D(self):
            return [[-5], [0], [0], [0]]

        def sensors(self):
            on, vane = Sensor(x=2.0), Sensor(x=2.0, airspeed=40.0)
            return {"az": on, "w": on, "alpha": vane, "q": Sensor(scale=1.1)}

    model = Boomed(place=2.0, k_q=1.1)
    for each in (model, model.at({"w": 3.0})):  # at its reference, and elsewhere
        found, expected = each.system(), Linear().system()
        for part in "ABCD":
            np.testing.assert_allclose(getattr(found, part), getattr(expected, part), atol=1e-12)


@pytest.mark.second
def test_place_and_scale_of_a_nonlinear_structure_are_estimated():
    rng, t = np.random.default_rng(4), np.arange(0, 12, 0.04)
    u = 0.1 * np.sign(np.sin(1.3 * t**1.2))[:, None]
    A, B = np.array([[-0.6, 40], [-0.02, -1.5]]), np.array([-5, 8])
    x, y = np.zeros(2), np.zeros((len(t), 4))
    for n in range(len(t)):
        force = -0.6 * x[0] - 5 * u[n, 0] - 2.0 * (A @ x + B * u[n, 0])[1]
        y[n] = [force, 1.1 * x[1], x[0] - 2.0 * x[1], (x[0] - 2.0 * x[1]) / 40]
        for _ in range(40):  # held inputs
            x = x + 0.001 * (A @ x + B * u[n, 0])
    y += rng.standard_normal(y.shape) * [0.05, 0.003, 0.05, 0.002]
    record = Record(t, u, y, Boomed.inputs, Boomed.outputs, "flight", hold="zoh")
    fit = output_error(Boomed(), record)
    for name, true in (("place", 2.0), ("k_q", 1.1), ("Zw", -0.6), ("Mq", -1.5)):
        assert abs(fit[name].value - true) < 3 * fit[name].std_error, name
    assert fit["place"].std_error < 0.05


def test_sensors_of_nonlinear_structures_are_not_late():
    with pytest.raises(ModelError, match="sensors of nonlinear structures have no delay; shift"):
        type("Late", (RigidBody,), {"late_outputs": ("phi",)})
    late = type("Late", (RigidBody,), {"sensors": lambda _: {"phi": Sensor(delay=0.05)}})
    with pytest.raises(ModelError, match=r"'phi' has a delay, .* nonlinear structures do not"):
        late().equations()
