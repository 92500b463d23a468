"""Clocks of single attitudes: told by how they turn each other, and by nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from truths import bodies
from truths.logs import ANGLES, RATES, flight

from casid import Record, kinematic_check
from casid.consistency.flightpath import reconstruct
from casid.consistency.measured import Flight
from casid.consistency.parting import reconstruct_apart, reconstruct_level

OMEGA, PHASE = np.array([0.7, 1.1, 1.9, 2.6]), np.array([0.3, 2.0, 4.1, 5.2])
TURNING = ("p", "q", "r", "phi", "theta", "psi")
EQUATIONS = ("phi", "theta", "psi")


def waves(t, late=0.0, order=0):
    """Four sines of 0.1 each, so many seconds late, and derivatives; order -1 is the integral."""
    angle = OMEGA * (t[:, None] - late) + PHASE + order * np.pi / 2
    return np.sum(0.1 * OMEGA ** float(order) * np.sin(angle), axis=1)


def turned(seed=4, **late):
    """Flights of a rigid body that turns about all axes, channels late by so much."""
    flown = bodies.flown(seed, late=late, outputs=TURNING, noise=0.3)
    return [Flight(r.dt, k, dict(zip(TURNING, r.y.T, strict=True))) for k, r in enumerate(flown)]


def small_angles(seed=0):
    """A flight in which p, q and r are the slopes of φ, θ and ψ, as of small angles."""
    _, found = flight(seed=seed)
    x = {name: found[name][::4] for name in (*RATES, *ANGLES)}
    x["psi"] = 0.02 * np.cumsum(x["r"])
    return Flight(0.02, 0, x)


@pytest.mark.second
def test_a_rigid_body_turns_its_attitudes_once_and_small_angles_never():
    more, error = reconstruct(turned(), EQUATIONS).coupled
    assert abs(more) < 3 * error
    assert error < 0.2
    more, error = reconstruct([small_angles()], EQUATIONS).coupled
    assert abs(more + 1) < 0.1
    assert error < 0.1


@pytest.mark.second
def test_only_where_attitudes_turn_each_other_they_may_be_apart():
    apart = reconstruct_apart(turned(theta=0.06), EQUATIONS)
    assert apart.parted
    np.testing.assert_allclose(apart.clocks[:2], [0.06, 0.0], atol=0.01)
    assert not reconstruct_apart(turned(), EQUATIONS).parted
    for seed in range(4):  # clocks would take the place of what these do not have
        alone = small_angles(seed)
        assert not reconstruct_apart([alone], EQUATIONS).parted
        held = reconstruct([alone], EQUATIONS)
        np.testing.assert_array_equal(held.clocks[:2].round(5), 0.0)


def test_small_angles_are_not_called_late():
    t, x = flight()
    y = np.column_stack([x[name][::4] for name in (*RATES, *ANGLES)])
    record = Record(t[::4], np.zeros((len(y), 1)) + 0.1, y, ("lat",), (*RATES, *ANGLES))
    assert kinematic_check(record).shifts == {}


def tilted(rng, tilt, **known):
    """Bank of a flight at a pitch attitude, which is recorded, given or neither."""
    t = 0.02 * np.arange(1500)
    bank = waves(t, 0, -1) + np.tan(tilt) * waves(t, 0.3, -1) + 0.002 * rng.standard_normal(1500)
    values = {"p": waves(t), "r": waves(t, 0.3), "phi": bank}
    level = {} if "theta" in known else {"theta": known.get("level", 0.0)}
    if "theta" in known:
        values["theta"] = np.full(1500, known["theta"])
    return Flight(0.02, 0, values, level=level)


def test_where_pitch_attitude_is_not_known_errors_tell_of_it():
    rng = np.random.default_rng(6)
    unknown = [tilted(rng, 0.0), tilted(rng, 0.0)]
    level = reconstruct(unknown, ["phi"])
    other = reconstruct([replace(each, level={"theta": 0.1}) for each in unknown], ["phi"])
    wide = reconstruct_level(unknown, ["phi"])
    np.testing.assert_array_equal(wide.unknowns, level.unknowns)
    expected = np.sqrt(level.errors**2 + (other.unknowns - level.unknowns) ** 2)
    np.testing.assert_allclose(wide.errors, expected, rtol=1e-12)
    expected = np.sqrt(level.bias_errors**2 + (other.biases - level.biases) ** 2)
    np.testing.assert_allclose(wide.bias_errors, expected, rtol=1e-12)
    assert (wide.errors[0] > 3 * level.errors[0]).all()


@pytest.mark.parametrize("known", [{"theta": 0.0}, {"theta": 0.1}, {"level": 0.05}], ids=str)
def test_a_pitch_attitude_recorded_or_given_in_any_flight_leaves_errors_alone(known):
    rng = np.random.default_rng(6)
    flights = [tilted(rng, 0.0, **known), tilted(rng, 0.0)]
    if "theta" in known:
        flights = flights[:1]
    plain, found = reconstruct(flights, ["phi"]), reconstruct_level(flights, ["phi"])
    np.testing.assert_array_equal(found.errors, plain.errors)


def test_without_yaw_rate_pitch_attitude_does_not_matter():
    t = 0.02 * np.arange(900)
    bank = 0.2 + waves(t, 0.0, -1) + 0.01 * np.random.default_rng(3).standard_normal(900)
    rolls = [Flight(0.02, 0, {"p": waves(t, 0.12), "phi": bank}, level={"theta": 0.0})]
    plain, found = reconstruct(rolls, ["phi"]), reconstruct_level(rolls, ["phi"])
    np.testing.assert_array_equal(found.errors, plain.errors)
