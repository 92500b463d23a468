"""Bandwidth, phase delay and margins against closed forms and python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest
import scipy.optimize
from truths.attitudes import OMEGA, response, roll

from casid.baseline.handling import handling_qualities


def at_phase(degrees, lag=0.3, delay=0.1):
    def excess(w):
        return -90 - np.degrees(np.arctan(lag * w) + delay * w) - degrees

    return scipy.optimize.brentq(excess, 0.01, 100)


def test_bandwidth_and_phase_delay_are_those_of_the_closed_form():
    read = handling_qualities(response(roll), ("phi", "lat"))
    w180 = at_phase(-180)
    target = 2 * np.abs(roll(1j * w180))

    def excess(w):
        return np.abs(roll(1j * w)) - 10 ** (6 / 20) / 2 * target

    lost = -180 + 90 + np.degrees(np.arctan(0.3 * 2 * w180) + 0.1 * 2 * w180)
    # 800 points over 2.6 decades: linear interpolation in log ω is good to (0.0075)²/8 of a turn.
    assert read.omega_180 == pytest.approx(w180, rel=1e-4)
    assert read.bandwidth_phase == pytest.approx(at_phase(-135), rel=1e-4)
    assert read.bandwidth_gain == pytest.approx(scipy.optimize.brentq(excess, 0.1, w180), rel=1e-4)
    assert read.bandwidth == min(read.bandwidth_phase, read.bandwidth_gain)
    assert read.phase_delay == pytest.approx(lost / (np.degrees(1) * 2 * w180), rel=1e-3)
    assert read.phase_delay_line == pytest.approx(read.phase_delay, rel=0.1)
    assert read.satisfactory is None
    assert not read.remarks


def test_a_rate_is_integrated_and_a_reversed_stick_turned_round():
    attitude = handling_qualities(response(roll), ("phi", "lat"))
    rate = handling_qualities(response(lambda s: -s * roll(s), name="p"), ("p", "lat"),
                              kind="rate", sign=-1)  # fmt: skip
    for name in ("omega_180", "bandwidth", "phase_delay"):
        assert getattr(rate, name) == pytest.approx(getattr(attitude, name), rel=1e-12)


def test_an_attitude_command_is_judged_by_phase_alone():
    def command(s):
        return np.exp(-0.1 * s) / (s**2 / 9 + 1.4 * s / 3 + 1)

    free = handling_qualities(response(command), ("phi", "lat"))
    held = handling_qualities(response(command), ("phi", "lat"), attitude_command=True)
    assert held.bandwidth == held.bandwidth_phase == free.bandwidth_phase
    assert free.bandwidth == min(free.bandwidth_gain, free.bandwidth_phase)


def test_whole_turns_of_an_unstable_phugoid_do_not_matter():
    def pitch(s):  # the unstable pair adds 180° where the stable one would take it
        return roll(s) * s**2 / (s**2 - 0.06 * s + 0.09)

    read = handling_qualities(response(pitch), ("phi", "lat"))
    assert read.bandwidth_phase == pytest.approx(at_phase(-135), rel=0.05)


def test_margins_are_those_of_python_control():
    system = control.tf([8], [0.05, 0.55, 1.5, 1, 0])
    read = handling_qualities(response(system), ("phi", "lat"), kind="loop")
    gain_margin, phase_margin, omega_180, crossover = control.margin(system)
    assert read.gain_margin == pytest.approx(20 * np.log10(gain_margin), abs=0.01)
    assert read.phase_margin == pytest.approx(phase_margin, abs=0.05)
    assert read.omega_180 == pytest.approx(omega_180, rel=1e-3)
    assert read.crossover == pytest.approx(crossover, rel=1e-3)
    assert read.satisfactory is False


def test_a_loop_with_both_margins_is_satisfactory():
    read = handling_qualities(response(lambda s: 1 / (s * (0.1 * s + 1) * (0.05 * s + 1))),
                              ("phi", "lat"), kind="loop")  # fmt: skip
    assert read.satisfactory is True
    assert read.phase_margin > 45
    assert read.gain_margin > 6


def test_an_unstable_loop_is_not_satisfactory_however_far_from_the_critical_point():
    def loop(s):  # stable below a gain of 30
        return 3000 / (s * (0.1 * s + 1) * (0.05 * s + 1))

    read = handling_qualities(response(loop, np.geomspace(1, 200, 800)), ("phi", "lat"),
                              kind="loop")  # fmt: skip
    assert abs(read.phase_margin) > 45
    assert abs(read.gain_margin) > 6
    assert read.satisfactory is False
    assert any("the closed loop is unstable" in remark for remark in read.remarks)


def rational(num, den):
    return response(
        lambda s: np.polyval(num, s) / np.polyval(den, s), np.geomspace(1e-3, 1e4, 6000)
    )


def test_a_loop_that_encircles_the_critical_point_is_not_satisfactory():
    # Two light modes turn the phase by a whole turn above 0 dB: both margins look wide.
    modes = np.polymul([1, 0.2, 100], [1, 0.22, 121])
    num, den = [100 * 121.0], np.polymul([1, 0], modes)
    assert np.roots(np.polyadd(den, num)).real.max() > 0  # closed loop
    read = handling_qualities(rational(num, den), ("phi", "lat"), kind="loop")
    assert abs(read.phase_margin) > 45
    assert abs(read.gain_margin) > 6
    assert read.satisfactory is False
    (remark,) = read.remarks
    assert "downwards 1 time(s) more than upwards: the closed loop is unstable" in remark


def test_a_phase_that_comes_back_above_0_db_encircles_nothing():
    num, den = 50 * np.polymul([1, 1], [1, 1]), np.polymul([1, 0], np.polymul([1, 0.1], [1, 0.1]))
    assert np.roots(np.polyadd(den, num)).real.max() < 0  # closed loop
    read = handling_qualities(rational(num, den), ("phi", "lat"), kind="loop")
    assert read.satisfactory is True
    assert read.remarks == ()


@pytest.mark.campaign
def test_loops_said_to_encircle_the_critical_point_are_unstable_when_closed():
    rng, said = np.random.default_rng(4), 0
    for _ in range(500):
        size = np.exp(rng.uniform(-1, 3, size=4))
        damping = rng.choice([-0.1, 0.05, 0.7], size=2, p=[0.3, 0.4, 0.3])
        den = np.polymul(*([1, 2 * z * w, w**2] for z, w in zip(damping, size, strict=False)))
        num = np.exp(rng.uniform(-1, 4)) * np.polymul([1, size[2]], [1, size[3]])
        num *= rng.choice([-1, 1])
        read = handling_qualities(rational(num, den), ("phi", "lat"), kind="loop")
        if any("the closed loop is unstable" in remark for remark in read.remarks):
            said += 1
            assert np.roots(np.polyadd(den, num)).real.max() > 0
    assert said > 100


def test_a_stable_loop_around_an_unstable_aircraft_is_satisfactory():
    # Closed, s² + 7.5 s + 1: stable. The gain rises through 0 dB with the phase beyond 180°.
    read = handling_qualities(response(lambda s: 8 * s / (s**2 - 0.5 * s + 1), OMEGA),
                              ("phi", "lat"), kind="loop")  # fmt: skip
    assert read.satisfactory is True
    assert abs(read.phase_margin) > 45
    assert read.gain_margin == pytest.approx(-20 * np.log10(8 / 0.5), abs=0.01)
    assert not read.remarks


def test_a_phase_that_passes_minus_180_several_times_is_told():
    def loop(s):
        light = (s**2 + 0.24 * s + 5.76) / (s**2 + 0.2 * s + 4)
        return 10 * light / (s * (s + 3)) * np.exp(-0.05 * s)

    omega = np.geomspace(0.05, 50, 2000)
    turned = np.degrees(np.unwrap(np.angle(loop(1j * omega)))) + 180
    at = omega[1:][np.diff(np.sign(turned)) != 0]
    assert len(at) == 3
    read = handling_qualities(response(loop, omega), ("phi", "lat"))
    (told,) = (each for each in read.remarks if "crosses -180° again" in each)
    places = told.split("at ")[1].split(" rad/s")[0].split(", ")
    np.testing.assert_allclose([float(each) for each in places], at[1:], rtol=0.01)


def test_a_growing_mode_that_raises_the_phase_through_minus_180_passes_it_once():
    def aircraft(s):
        return 6 * (s + 0.05) / ((s**2 - 0.16 * s + 0.18) * (s + 1.5)) * np.exp(-0.08 * s)

    omega = np.geomspace(0.2, 30, 500)
    phase = np.degrees(np.unwrap(np.angle(aircraft(1j * omega))))
    phase -= 360 * np.round((phase[-1] + 270) / 360)
    up, down = omega[1:][np.diff(np.sign(phase + 180)) != 0]
    assert phase[0] < -180
    read = handling_qualities(response(aircraft, omega), ("phi", "lat"))
    assert up < 1 < down == pytest.approx(read.omega_180, rel=0.02)
    # A straight line of phase delays by half of what it loses per rad/s.
    beyond = np.interp(2 * read.omega_180, omega, phase)
    assert read.phase_delay == pytest.approx(np.radians(-180 - beyond) / 2 / read.omega_180, 0.01)
    assert not [each for each in read.remarks if "again" in each]


def test_what_lies_outside_the_band_is_said():
    low = response(roll, np.geomspace(0.1, 7.0, 300))
    read = handling_qualities(low, ("phi", "lat"))
    assert np.isnan(read.phase_delay)
    assert any("beyond the grid" in remark for remark in read.remarks)
    with pytest.raises(ValueError, match="does not pass -180°"):
        handling_qualities(response(roll, np.geomspace(0.1, 2.0, 50)), ("phi", "lat"))
    loop = handling_qualities(response(lambda s: 0.1 / (s + 1)), ("phi", "lat"), kind="loop")
    assert loop.satisfactory is None
    assert len(loop.remarks) == 2


def test_poor_coherence_is_said():
    read = handling_qualities(response(roll, coherence=0.4), ("phi", "lat"))
    assert any("coherence falls to 0.40" in remark for remark in read.remarks)


@pytest.mark.parametrize("choice", [{"kind": "yaw"}, {"sign": 2}])
def test_choices_are_checked(choice):
    with pytest.raises(ValueError, match="expected"):
        handling_qualities(response(roll), ("phi", "lat"), **choice)


def test_an_unmeasured_pair_is_refused():
    frf = response(roll)
    frf = replace(frf, G=np.full_like(frf.G, np.nan))
    with pytest.raises(ValueError, match="measured at 0 frequencies"):
        handling_qualities(frf, ("phi", "lat"))


def test_of_several_crossings_the_last_before_minus_180_counts():
    # Phase [deg] and gain [dB] at six points, linear in log ω between them.
    omega = np.array([1.0, 2.0, 3.0, 4.0, 8.0, 16.0])
    phase = np.array([-120.0, -140.0, -125.0, -145.0, -185.0, -230.0])
    gain = np.array([20.0, 2.0, 14.0, 6.0, -2.0, -12.0])
    G = 10 ** (gain / 20) * np.exp(1j * np.radians(phase))
    read = handling_qualities(response(lambda _: G, omega), ("phi", "lat"))
    assert read.omega_180 == pytest.approx(4 * 2 ** (35 / 40))
    assert read.bandwidth_phase == pytest.approx(3 * (4 / 3) ** (10 / 20))
    at_180 = 6 - 8 * 35 / 40  # and 6 dB more are passed twice between 1 and 3 rad/s, then here:
    assert read.bandwidth_gain == pytest.approx(4 * 2 ** ((6 - (at_180 + 6)) / 8))
    held = handling_qualities(response(lambda _: G, omega), ("phi", "lat"), attitude_command=True)
    for found, told in ((read, True), (held, False)):  # whose gain bandwidth does not count
        assert any("the gain is 6 dB above" in each for each in found.remarks) is told


@pytest.mark.parametrize(
    ("end", "factor", "said"),
    [("low", 0.9, False), ("low", 1.1, True), ("high", 0.9, True), ("high", 1.1, False)],
)
def test_coherence_counts_from_the_bandwidth_to_twice_omega_180(end, factor, said):
    omega = np.geomspace(0.5, 30.0, 400)
    frf = response(roll, omega)
    read = handling_qualities(frf, ("phi", "lat"))
    place = factor * {"low": read.bandwidth, "high": 2 * read.omega_180}[end]
    coherence = np.where(np.abs(np.log(omega / place)) < 0.02, 0.3, 1.0)[:, None, None]
    remarks = handling_qualities(replace(frf, coherence=coherence), ("phi", "lat")).remarks
    assert any("coherence falls to 0.30" in each for each in remarks) is said


def test_several_crossings_of_minus_135_are_told():
    # Airframe with a notch and a mode above: the phase comes back between them.
    def sluggish(s):
        notch = (s**2 + 1.4 * s + 49) / (s**2 + 0.8 * s + 64)
        return 20 / (s * (s + 1)) * notch * np.exp(-0.05 * s)

    omega = np.geomspace(0.1, 30, 20000)
    phase = np.unwrap(np.angle(sluggish(1j * omega))) + 0.75 * np.pi
    places = omega[:-1][np.diff(np.sign(phase)) != 0]
    read = handling_qualities(response(sluggish), ("phi", "lat"), attitude_command=True)
    assert len(places) == 3
    assert read.bandwidth == pytest.approx(places[-1], rel=1e-3)
    told = ", ".join(f"{place:.2g}" for place in places)
    (remark,) = read.remarks
    found = remark.split(" at ")[1].split(" rad/s")[0].split(", ")
    assert ", ".join(f"{float(each):.2g}" for each in found) == told


def test_a_conditionally_stable_loop_is_not_called_unstable():
    num = 2 * np.polymul([1, 6, 9], [1, 0.032, 0.64])
    den = np.polymul([1, 0, 0, 0], [1, 1.6, 0.64])
    assert np.roots(np.polyadd(den, num)).real.max() < 0  # closed loop
    loop = response(lambda s: np.polyval(num, s) / np.polyval(den, s))
    read = handling_qualities(loop, ("phi", "lat"), kind="loop")
    assert not read.remarks
    assert read.unstable_poles == 0


def resonant(s):
    return 1.2 / s * 25 / (s**2 + 0.2 * s + 25) * np.exp(-0.01 * s)


def test_the_margin_of_an_unstable_loop_is_that_where_it_is_lost():
    # The gain falls through 0 dB, rises with +81° and falls again with -81° beyond -180°.
    omega = np.geomspace(0.05, 60, 4000)
    read = handling_qualities(response(resonant, omega=omega), ("phi", "lat"), kind="loop")
    lost = scipy.optimize.brentq(lambda w: np.abs(resonant(1j * w)) - 1, 5.1, 20)
    margin = 180 + np.degrees(np.angle(resonant(1j * lost))) - 360
    assert read.crossover == pytest.approx(lost, rel=1e-4)
    assert read.phase_margin == pytest.approx(margin, abs=0.1)
    assert read.satisfactory is False
    assert "at 5.51 rad/s: the closed loop is unstable" in read.remarks[0]
    assert len(read.remarks) == 1


def test_a_gain_that_rises_last_is_no_place_where_a_loop_is_lost():
    def loop(s):
        x = np.log(np.abs(s))
        gain = np.interp(x, np.log([0.5, 2.0, 3.0, 5.0, 20.0]), [20.0, 0.0, -8.0, 0.0, 12.0])
        phase = np.interp(x, np.log([0.5, 2.0, 3.5, 5.0]), [-120.0, -150.0, -180.0, -240.0])
        return 10 ** (gain / 20) * np.exp(1j * np.radians(phase))

    read = handling_qualities(response(loop), ("phi", "lat"), kind="loop")
    assert read.crossover == pytest.approx(2.0, rel=1e-3)
    assert read.phase_margin == pytest.approx(30.0, abs=0.5)


def test_a_grid_too_coarse_for_a_margin_is_told():
    at = scipy.optimize.brentq(lambda w: resonant(1j * w).imag, 4.5, 5.5)
    margin = -20 * np.log10(np.abs(resonant(1j * at)))
    for points, told in ((120, 1), (800, 0)):
        frf = response(resonant, omega=np.geomspace(0.05, 60, points))
        read = handling_qualities(frf, ("phi", "lat"), kind="loop")
        assert (abs(read.gain_margin - margin) > 1) == bool(told)
        said = [each for each in read.remarks if "give the response on a finer grid" in each]
        assert len(said) == told
    assert read.gain_margin == pytest.approx(margin, abs=0.2)


def test_phase_delays_that_contradict_each_other_are_told():
    def mode(s):  # lightly damped, just above ω_180: the phase rises and falls back
        return (s**2 + 0.64 * s + 64) / (s**2 + 0.28 * s + 49)

    omega = np.geomspace(0.3, 30, 600)
    plain = handling_qualities(response(roll, omega=omega), ("phi", "lat"))
    assert not plain.remarks
    read = handling_qualities(
        response(lambda s: 10 / (s * (s + 3)) * mode(s) * np.exp(-0.06 * s), omega=omega),
        ("phi", "lat"),
    )
    assert read.phase_delay > 0 > read.phase_delay_line
    assert any("not a straight line from ω_180 to 2ω_180" in each for each in read.remarks)
