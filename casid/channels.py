"""Names of the channels a rotorcraft usually has, and units of measurement."""

import re
from collections.abc import Collection, Mapping

from casid.checks import check_known

CONTROLS = ("col", "lat", "lon", "ped")
RATES, FORCES = ("p", "q", "r"), ("ax", "ay", "az")
ATTITUDES, VELOCITIES = ("phi", "theta", "psi"), ("u", "v", "w")
AIR = ("V", "alpha", "beta")  # airspeed, angles of attack and sideslip: velocities, too
UNITS = {  # in which a channel of that name is
    **dict.fromkeys(FORCES, "m/s²"),
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(ATTITUDES, "rad"),
    **dict.fromkeys(VELOCITIES, "m/s"),
    **dict(zip(AIR, ("m/s", "rad", "rad"), strict=True)),
    **dict.fromkeys(CONTROLS, "travel"),
}

GRAVITY = 9.80665  # m/s²
TURN = 6.283185307179586  # rad
DEGREE = TURN / 360
MEASURES = {  # SI unit -> what one of each unit is in it; PWM travels 1000 µs, u16 has 16 bits
    "1": {"1": 1.0, "-": 1.0, "%": 0.01, "pwm": 1e-3, "u16": 1 / 65535},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "rad": {"rad": 1.0, "deg": DEGREE, "mrad": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": DEGREE, "dps": DEGREE, "mrad/s": 1e-3, "rpm": TURN / 60},
    "rad/s²": {"rad/s^2": 1.0, "rad/s²": 1.0, "deg/s^2": DEGREE},
    "m": {"m": 1.0, "ft": 0.3048, "in": 0.0254, "cm": 0.01, "mm": 1e-3, "km": 1e3},
    "m/s": {"m/s": 1.0, "ft/s": 0.3048, "kt": 1852 / 3600, "kn": 1852 / 3600, "km/h": 1 / 3.6}
    | {"ft/min": 0.3048 / 60, "mph": 0.44704, "cm/s": 0.01, "mm/s": 1e-3},
    "m/s²": {"m/s^2": 1.0, "m/s²": 1.0, "ft/s^2": 0.3048, "g": GRAVITY, "mg": 1e-3 * GRAVITY},
}
PULSES = ("us", "µs")  # of a control: pulses of a servo
SI = {unit: factor for row in MEASURES.values() for unit, factor in row.items()}
WORDS = {  # parts of units, in lower case, as they are written beside those that are known
    **dict.fromkeys(("degree", "degrees", "°", "degheading"), "deg"),
    **dict.fromkeys(("radian", "radians", "rads"), "rad"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "µsec", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("hr", "hour", "hours"), "h"),
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("kilometer", "kilometers", "kilometre", "kilometres"), "km"),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("milliradian", "milliradians"), "mrad"),
    **dict.fromkeys(("foot", "feet"), "ft"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("s2", "s²", "s**2", "sec2", "sec^2", "sec²", "sec**2"), "s^2"),
    **dict.fromkeys(("second2", "second^2", "second²", "second squared"), "s^2"),
}
SPELT = {  # whole units, likewise, their parts as above
    **dict.fromkeys(("kts", "knot", "knots", "nmi/h"), "kt"),
    **dict.fromkeys(("percent", "per cent", "pct"), "%"),
    **dict.fromkeys(("kmh", "kph"), "km/h"),
    **dict.fromkeys(("mi/h", "mile/h", "miles/h"), "mph"),
    **dict.fromkeys(("rev/min", "revolutions/min", "r/min"), "rpm"),
    "fpm": "ft/min",
    "fps": "ft/s",
    "mps": "m/s",
    "m/s/s": "m/s^2",
    "ft/s/s": "ft/s^2",
    "deg/s/s": "deg/s^2",
    "rad/s/s": "rad/s^2",
    "g's": "g",
    "milli-g": "mg",
}
POWER = re.compile(r"[ .*·]?(s|sec|second|min|h|hr|hour)(?:\^|\*\*)?(?:-([12])|⁻([¹²]))$")  # m s-2


def spelt(unit: str) -> str:
    """A unit as casid writes it, ``"knots"`` kt, ``"Degrees per second"`` deg/s; itself if none."""
    if unit in SI:
        return unit
    plain = " ".join(unit.replace("μ", "µ").split()).lower().replace(" per ", "/")
    if found := POWER.search(plain):
        plain = f"{plain[: found.start()]}/{found[1]}{'^2' * ((found[2] or found[3]) in '2²')}"
    parts = (part.strip() for part in plain.split("/"))
    joined = "/".join(WORDS.get(part, part) for part in parts)
    known = SPELT.get(joined, joined)
    return known if known in SI else unit


def in_si(unit: str) -> float | None:
    """What one of a unit is in SI, however it is spelt; None of one that is not known."""
    return SI.get(spelt(unit))


def measure(unit: str) -> str:
    """The SI unit of what a known unit measures."""
    return next(si for si, row in MEASURES.items() if spelt(unit) in row)


def factor_of(channel: str, unit: str, *, time: bool = False) -> float:
    """What one of a channel's unit is in SI; ValueError for an unknown unit, or no unit of time."""
    unit = spelt(unit)
    check_known(f"channel {channel!r}: unknown unit", [unit], SI)
    if time:
        check_known(f"time {channel!r}: no unit of time", [unit], MEASURES["s"])
    return SI["pwm" if channel in CONTROLS and unit in PULSES else unit]


def misnamed(channel: str, unit: str) -> str:
    """Why a unit is odd for a channel of that name; empty where it is not."""
    si, pulses = measure(unit), spelt(unit) in PULSES
    if channel in CONTROLS:
        odd = (si == "s" and not pulses) or si == "m"  # inches: guesses are per travel
        usual = "a share of its travel (a factor in [channels.columns]), an angle or pulses"
    else:
        odd, usual = UNITS.get(channel, si) != si, UNITS.get(channel, si)
    return f"{channel} is said to be in {unit}, where {usual} is usual" if odd else ""


def units_of(stated: Mapping[str, str]) -> dict[str, str]:
    """SI unit by channel, given the units that were stated of columns; a number has its name's."""
    read_as = {unit: si for si, row in MEASURES.items() for unit in row if si != "1"}
    stated = {k: spelt(u) for k, u in stated.items()}
    stated = {k: u for k, u in stated.items() if k not in CONTROLS or u not in PULSES}
    return UNITS | {name: read_as[unit] for name, unit in stated.items() if unit in read_as}


def own_units(stated: Mapping[str, str], names: Collection[str]) -> dict[str, str]:
    """Those of channels of these names that stated units make others than names say."""
    found = units_of(stated)
    return {k: found[k] for k in stated if k in names and found.get(k) != UNITS.get(k)}
