"""Units by their definitions: NIST SP 811 for feet, knots and g, SI for the rest."""

import numpy as np
import pytest

from casid.channels import MEASURES, SI, factor_of, in_si, misnamed, own_units, spelt, units_of


@pytest.mark.parametrize(
    ("unit", "in_si"),
    [("deg", np.pi / 180), ("dps", np.pi / 180), ("kt", 1852 / 3600), ("km/h", 1000 / 3600),
     ("ft/s", 0.3048), ("in", 0.3048 / 12), ("g", 9.80665), ("%", 0.01), ("ms", 1e-3),
     ("pwm", 1 / 1000), ("deg/s^2", np.pi / 180), ("rpm", 2 * np.pi / 60), ("mg", 9.80665e-3),
     ("mph", 1609.344 / 3600), ("ft/min", 0.3048 / 60), ("mm", 1e-3), ("km", 1e3),
     ("cm", 1e-2), ("cm/s", 1e-2), ("mm/s", 1e-3), ("mrad", 1e-3), ("mrad/s", 1e-3)],
)  # fmt: skip
def test_one_of_each_unit_is_what_its_definition_says(unit, in_si):
    assert factor_of("p", unit) == pytest.approx(in_si, rel=1e-15)


def test_an_unknown_unit_is_refused_with_those_known():
    with pytest.raises(ValueError, match="'p': unknown unit 'mach'; known are 1, -, %"):
        factor_of("p", "mach")


def test_a_channel_has_the_si_unit_of_what_was_stated_or_of_its_name():
    units = units_of({"lat": "deg", "ped": "%", "beta": "deg", "ay": "g"})
    wanted = {"lat": "rad", "ped": "travel", "beta": "rad", "ay": "m/s²", "q": "rad/s"}
    assert {name: units[name] for name in wanted} == wanted
    assert all(SI[si] == 1.0 for si in MEASURES)


def test_microseconds_of_a_stick_are_those_of_servo_pulses():
    assert factor_of("lat", "µs") == factor_of("lat", "us") == factor_of("lat", "pwm") == 1e-3
    assert factor_of("t", "µs") == 1e-6
    assert units_of({"lat": "µs", "t": "µs"})["lat"] == "travel"


@pytest.mark.parametrize("unit", ["ft", "deg", "1"])
def test_time_is_in_units_of_time(unit):
    assert factor_of("t", "ms", time=True) == 1e-3
    with pytest.raises(ValueError, match="time 't': no unit of time"):
        factor_of("t", unit, time=True)


def test_units_that_a_channel_of_that_name_hardly_has_are_told():
    for channel, unit in (("p", "deg/s"), ("lat", "deg"), ("lat", "us"), ("V", "knots")):
        assert not misnamed(channel, unit)
    assert misnamed("p", "kt") == "p is said to be in kt, where rad/s is usual"
    assert misnamed("beta", "knots") == "beta is said to be in knots, where rad is usual"
    assert "lat is said to be in ms" in misnamed("lat", "ms")
    assert "lat is said to be in in, where a share of its travel (a fac" in misnamed("lat", "in")


def test_units_of_records_are_those_that_names_do_not_say():
    stated = {"lat": "degrees", "ped": "%", "beta": "deg", "h": "feet", "t": "ms", "x": "1"}
    assert own_units(stated, ("lat", "ped", "beta", "h", "x")) == {"lat": "rad", "h": "m"}


ALIKE = {  # what writers of logs, CF conventions and flight-test cards spell, by what it means
    "kt": ("kts", "KTS", "knots", "Knot"),
    "deg": ("degrees", "Degree", "°", "DEG"),
    "rad": ("radians", "Rad"),
    "%": ("percent", "per cent", "PCT"),
    "deg/s": ("deg/sec", "°/s", "Degrees per second", "degree s-1", "deg s^-1"),
    "rad/s": ("radians/second", "rad s⁻¹", "RAD/SEC"),
    "ft/s": ("feet/s", "ft/sec", "fps", "feet per second"),
    "m/s": ("m/sec", "metres per second", "m s-1", "M/S"),
    "km/h": ("kph", "km/hr", "kilometers per hour"),
    "m/s^2": ("m/s2", "m/s/s", "m s-2", "m/sec²", "meters per second squared"),
    "ft/s^2": ("feet/sec^2", "ft/s/s"),
    "g": ("G", "g's"),
    "ft": ("feet", "Foot"),
    "ms": ("milliseconds", "msec"),
    "rad/s^2": ("radians/sec^2", "rad s-2", "rad/s/s"),
    "deg/s^2": ("deg/sec²", "°/s/s", "degrees per second squared"),
    "rpm": ("RPM", "rev/min", "revolutions per minute"),
    "mph": ("MPH", "miles per hour"),
    "ft/min": ("fpm", "feet per minute", "ft min-1"),
    "mm": ("millimetres",),
}


@pytest.mark.parametrize("unit", ALIKE)
def test_a_unit_is_the_same_however_it_is_spelt(unit):
    for name in (unit, *ALIKE[unit]):
        assert spelt(f" {name} " if name != unit else name) == unit
        assert factor_of("p", name) == SI[unit]
        assert in_si(name) == SI[unit]


@pytest.mark.parametrize(
    "unit", ["mach", "V", "counts", "rps", "deg/s/s/s", "", "Gauss", "n/a", "/"]
)
def test_what_is_no_known_unit_stays_one(unit):
    assert spelt(unit) == unit
    assert in_si(unit) is None
