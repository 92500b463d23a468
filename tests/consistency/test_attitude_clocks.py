"""Clocks of single attitudes: told by how they turn each other, and by nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from truths import bodies
from truths.logs import ANGLES, RATES, flight

from casid import Record, kinematic_check
from casid.consistency.attitude_clocks import reconstruct_apart, reconstruct_level
from casid.consistency.flightpath import TILT, reconstruct
from casid.consistency.measured import Flight
from casid.samples import root_mean_square

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


TIME = 0.02 * np.arange(1500)


def tilted(rng, tangent, scale=1.0, level=0.0, *, late=0.3, share=1.0):
    """A flight at a pitch attitude (tangent) that is not recorded: φ' = p + r cos φ tan θ.

    r cos φ is a share of what p was.
    """
    bank = waves(TIME, 0, -1) + share * tangent * waves(TIME, late, -1)
    r = share * waves(TIME, late) / np.cos(bank)
    bank = bank + 0.002 * rng.standard_normal(len(TIME))
    values = {"p": scale * waves(TIME), "r": r, "phi": bank}
    return Flight(0.02, 0, values, level={"theta": level})


def test_an_unknown_pitch_attitude_is_found_beside_the_scale():
    for seed in range(4):
        flights = [
            replace(tilted(np.random.default_rng([seed, k]), tan, 1.3), record=k)
            for k, tan in enumerate((0.15, -0.1))
        ]
        found = reconstruct_level(flights, ["phi"])
        gain, error = found.unknowns[0, 0], found.errors[0, 0]
        assert abs(gain - 1 / 1.3) < 4 * error < 0.04
        means = found.tilts.mean(axis=1)
        np.testing.assert_allclose(means, np.arctan([0.15, -0.1]), atol=0.02)


def test_where_yaw_is_a_share_of_roll_a_credible_pitch_attitude_is_all_that_is_known():
    level = tilted(np.random.default_rng(6), 0.0, late=0.0, share=0.5)
    found = reconstruct_level([level], ["phi"])
    # Of a mean known to TILT and of knots about it, which are known as well each.
    expected = 0.5 * TILT * np.sqrt(1 + 1 / found.tilts.shape[1])
    assert found.errors[0, 0] == pytest.approx(expected, rel=0.1)
    assert abs(found.unknowns[0, 0] - 1) < 0.02


@pytest.mark.parametrize("known", ["recorded", "given"])
def test_a_pitch_attitude_recorded_or_given_is_no_unknown(known):
    rng, tan = np.random.default_rng(6), 0.1
    flight, free = tilted(rng, tan, level=np.arctan(tan)), tilted(rng, tan)
    if known == "recorded":
        flight.values["theta"] = np.full(len(TIME), np.arctan(tan))
    found = reconstruct_level([flight], ["phi"])
    assert found.tilts.size == 0
    assert found.errors[0, 0] < reconstruct_level([free], ["phi"]).errors[0, 0]
    if known == "given":  # in one of two records
        both = reconstruct_level([free, replace(flight, record=1)], ["phi"])
        assert abs(both.tilts[0].mean() - np.arctan(tan)) < 0.02
        np.testing.assert_allclose(both.tilts[1], 0.0, atol=1e-12)


def test_no_pitch_attitude_stands_in_for_what_turns_otherwise():
    rng = np.random.default_rng(2)
    steep = tilted(rng, 1.5, late=2.0)
    free, found = reconstruct([steep], ["phi"]), reconstruct_level([steep], ["phi"])
    assert root_mean_square(free.tilts) > 0.8
    assert (found.errors > np.abs(found.unknowns - free.unknowns)).all()  # were it true
    assert found.tilts.size == 0
    assert np.std(found.left["phi"][0]) > 0.3 * np.std(steep.values["phi"])


def test_without_yaw_rate_pitch_attitude_does_not_matter():
    t = 0.02 * np.arange(900)
    bank = 0.2 + waves(t, 0.0, -1) + 0.01 * np.random.default_rng(3).standard_normal(900)
    rolls = [Flight(0.02, 0, {"p": waves(t, 0.12), "phi": bank}, level={"theta": 0.0})]
    plain, found = reconstruct(rolls, ["phi"]), reconstruct_level(rolls, ["phi"])
    np.testing.assert_array_equal(found.errors, plain.errors)
