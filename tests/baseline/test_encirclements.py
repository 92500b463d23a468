"""Encirclements of -1 against the poles of the loop, open and closed."""

import numpy as np
import pytest
from truths.attitudes import response

from casid.baseline.encirclements import encirclements
from casid.baseline.handling import handling_qualities

BAND = np.geomspace(0.05, 60, 1500)


def curve(num, den, omega, delay=0.0):
    G = np.polyval(num, 1j * omega) / np.polyval(den, 1j * omega) * np.exp(-1j * omega * delay)
    phase = np.degrees(np.unwrap(np.angle(G)))
    return np.log(omega), 20 * np.log10(np.abs(G)), phase


def pade(delay, order=8):
    terms = [1.0]
    for k in range(order):
        terms.append(terms[-1] * (order - k) / ((2 * order - k) * (k + 1)) * delay)
    powers = np.array(terms[::-1])
    return powers * (-1.0) ** np.arange(order, -1, -1), powers


def closed(num, den, delay=0.0):
    below, above = pade(delay)
    return np.roots(np.polyadd(np.polymul(num, below), np.polymul(den, above)))


def roots(rng, count):
    """Roots to the left, real or in light, usual and well damped pairs."""
    found = []
    while len(found) < count:
        w = np.exp(rng.uniform(np.log(0.1), np.log(30)))
        z = rng.choice([0.05, 0.3, 0.7, 0.0]) if count - len(found) > 1 else 0.0
        found += list(np.roots([1, 2 * z * w, w * w])) if z else [-w]
    return np.array(found)


def mirrored(rng, found):
    """The same with one of them, and its conjugate, to the right."""
    one = found[rng.integers(len(found))]
    pair = np.isclose(found, one) | np.isclose(found, np.conj(one))
    return np.where(pair, -np.conj(found), found)


def random_loop(rng, right=False):
    order, integrators = rng.integers(1, 6), rng.integers(0, 3)
    poles = roots(rng, order)
    zeros = roots(rng, rng.integers(0, order))
    if right:
        poles = mirrored(rng, poles)
    if len(zeros) and rng.random() < 0.3:
        zeros = mirrored(rng, zeros)
    den = np.real(np.poly(np.r_[poles, np.zeros(integrators)]))
    num = np.atleast_1d(np.real(np.poly(zeros)))
    at = 1j * np.exp(rng.uniform(np.log(0.3), np.log(20)))
    size = np.abs(np.polyval(num, at) / np.polyval(den, at))
    return num * rng.choice([-1, 1]) / size, den, rng.choice([0, 0.03, 0.1])


def told(num, den, delay=0.0, omega=BAND):
    loop = curve(num, den, omega, delay)
    G = 10 ** (loop[1] / 20) * np.exp(1j * np.radians(loop[2]))
    return handling_qualities(response(lambda _: G, omega), ("phi", "lat"), kind="loop")


def unstable(read):
    return any("the closed loop is unstable" in each for each in read.remarks)


@pytest.mark.second
@pytest.mark.parametrize("right", [False, True])
def test_encirclements_are_half_of_the_unstable_poles_that_closing_adds(right):
    rng, wide, several = np.random.default_rng(20 + right), np.geomspace(2e-3, 2e3, 6000), set()
    for _ in range(120):
        num, den, delay = random_loop(rng, right)
        found = encirclements(*curve(num, den, wide, delay))
        open_ = np.sum(np.roots(den).real > 1e-9)
        assert 2 * found.number == np.sum(closed(num, den, delay).real > 0) - open_
        several.add(float(found.number))
    assert len(several) > 3


# As flown: gain, denominator, delay; each unstable when closed.
REVERSED = [
    (-30.0, np.polymul([1, 0], [0.1, 0.7, 1]), 0.06),
    (-15.0, [0.25, 1.25, 1], 0.15),
    (-8.0, np.polymul([2, 1], [0.2, 1]), 0.05),
    (-4.0, np.polymul([1, 0, 0], [0.02, 1]), 0.0),
]


@pytest.mark.parametrize(("gain", "den", "delay"), REVERSED)
def test_a_loop_of_the_wrong_sign_is_never_satisfactory(gain, den, delay):
    for low in (0.05, 0.3):
        omega = np.geomspace(low, 60, 800)
        wrong, right = (told([each], den, delay, omega) for each in (gain, -gain))
        assert closed([gain], den, delay).real.max() > 0
        assert wrong.satisfactory is not True
        assert (
            sum("a loop of the wrong sign begins like this" in each for each in wrong.remarks) == 1
        )
        assert not any("wrong sign" in each for each in right.remarks)


def test_a_zero_to_the_right_reverses_what_begins_below_it():
    num, den = [12.57, -51.16], [1, 6.482, 11.036, 3.241, 0.3611]
    assert closed(num, den).real.max() > 1
    read = told(num, den)
    assert abs(read.phase_margin) > 45
    assert abs(read.gain_margin) > 6
    assert read.satisfactory is False
    assert unstable(read)


def test_an_unstable_pole_that_the_loop_holds_is_presumed_in_words():
    den = np.polymul([1, -0.5], [0.02, 1])
    assert closed([4.0], den, 0.02).real.max() < 0
    read = told([4.0], den, 0.02)
    assert read.satisfactory is True
    assert read.unstable_poles == 1
    assert read.headline().endswith("margins satisfactory, if it has 1 unstable pole")
    assert not read.remarks
    plain = told([4.0], np.polymul([0.1, 1, 0], [0.02, 1]))
    assert plain.headline().endswith("margins satisfactory, if it is stable")


def test_a_mode_that_its_phase_keeps_stable_is_not_called_unstable():
    # Above 0 dB again by a light mode, between -180° and -360°: its circle lies off -1.
    num, den, delay = [400.0], np.polymul([1, 0], [1, 0.3, 400]), 0.0785
    assert closed(num, den, delay).real.max() < 0
    _, gain, phase = curve(num, den, BAND, delay)
    falling = np.flatnonzero((gain[:-1] > 0) & (gain[1:] <= 0))
    assert len(falling) == 2
    assert -360 < phase[falling[1]] < -180
    assert not unstable(told(num, den, delay))


def test_a_band_that_begins_in_doubt_has_no_verdict():
    # It begins on the flank of a phugoid, behind a zero: the phase falls, from where is not told.
    num, den = [1.507, 2.617, 0.175], [1, 0.78, 0.055, 0.03]
    for low, verdict in ((0.01, True), (0.15, None)):
        read = told(num, den, 0.15, np.geomspace(low, 60, 800))
        assert abs(read.phase_margin) > 45
        assert read.satisfactory is verdict
    assert (
        "begins like this, and so does one whose lower frequencies are missing" in read.remarks[0]
    )


def flown_loop(rng):
    """A stable loop around an aircraft whose phugoid may grow, by an autopilot with a lead."""
    while True:
        w, z = np.exp(rng.uniform(np.log(0.15), np.log(0.7))), rng.choice([-0.4, -0.15, 0.05, 0.3])
        den = np.polymul([1, 2 * z * w, w * w], [1, np.exp(rng.uniform(-0.7, 1.8))])
        num = np.polymul([1, np.exp(rng.uniform(-4, -1.2))], [rng.choice([0.3, 0.6, 1.0]), 1])
        if rng.random() < 0.6:
            num, den = np.polymul(num, [1, rng.choice([0.05, 0.2, 0.5])]), np.polymul(den, [1, 0])
        delay, at = rng.choice([0.05, 0.1, 0.15]), 1j * np.exp(rng.uniform(0.2, 1.6))
        num = num / np.abs(np.polyval(num, at) / np.polyval(den, at))
        if closed(num, den, delay).real.max() < -0.02:
            return num, den, delay


@pytest.mark.second
@pytest.mark.parametrize("low", [0.1, 0.2, 0.3, 0.5, 0.8])
def test_loops_flown_around_a_growing_phugoid_are_not_called_unstable(low):
    rng, omega, untold = np.random.default_rng(8), np.geomspace(low, 30, 60), 0
    for _ in range(100):
        num, den, delay = flown_loop(rng)
        x, gain, phase = curve(num, den, omega, delay)
        noise = 1 + 0.03 * (rng.standard_normal(60) + 1j * rng.standard_normal(60))
        gain, phase = gain + 20 * np.log10(np.abs(noise)), phase + np.degrees(np.angle(noise))
        found = encirclements(x, gain, phase)
        assert not found.unstable
        untold += found.beginning == "untold"
    assert untold <= 25


@pytest.mark.campaign
def test_of_stable_loops_hardly_one_that_is_unstable_when_closed_is_satisfactory():
    rng, counts = np.random.default_rng(31), np.zeros((2, 3), dtype=int)
    for _ in range(1500):
        num, den, delay = random_loop(rng)
        read = told(num, den, delay)
        bad = int(closed(num, den, delay).real.max() > 0)
        counts[bad] += [unstable(read), read.satisfactory is True, not unstable(read)]
    assert counts[0, 0] == 0  # stable ones called unstable
    assert counts[1, 1] <= 0.01 * counts[1].sum()
    assert counts[0, 1] > 80
