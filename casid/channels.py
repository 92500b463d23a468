"""Names of the channels a rotorcraft usually has, and units of measurement."""

from collections.abc import Collection, Mapping

from casid.checks import check_known

CONTROLS = ("col", "lat", "lon", "ped")
RATES, FORCES = ("p", "q", "r"), ("ax", "ay", "az")
ATTITUDES, VELOCITIES = ("phi", "theta", "psi"), ("u", "v", "w")
UNITS = {  # in which a channel of that name is
    **dict.fromkeys(FORCES, "m/s²"),
    **dict.fromkeys(RATES, "rad/s"),
    **dict.fromkeys(ATTITUDES, "rad"),
    **dict.fromkeys(VELOCITIES, "m/s"),
    **dict.fromkeys(CONTROLS, "travel"),
}

DEGREE = 0.017453292519943295  # rad
MEASURES = {  # SI unit -> what one of each unit is in it; PWM travels 1000 µs, u16 has 16 bits
    "1": {"1": 1.0, "-": 1.0, "%": 0.01, "pwm": 1e-3, "u16": 1 / 65535},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "rad": {"rad": 1.0, "deg": DEGREE},
    "rad/s": {"rad/s": 1.0, "deg/s": DEGREE, "dps": DEGREE},
    "m": {"m": 1.0, "ft": 0.3048, "in": 0.0254},
    "m/s": {"m/s": 1.0, "ft/s": 0.3048, "kt": 1852 / 3600, "kn": 1852 / 3600, "km/h": 1 / 3.6},
    "m/s²": {"m/s^2": 1.0, "m/s²": 1.0, "ft/s^2": 0.3048, "g": 9.80665},
}
PULSES = ("us", "µs")  # of a control: pulses of a servo
SI = {unit: factor for row in MEASURES.values() for unit, factor in row.items()}


def factor_of(channel: str, unit: str, *, time: bool = False) -> float:
    """What one of a channel's unit is in SI; ValueError for an unknown unit, or no unit of time."""
    check_known(f"channel {channel!r}: unknown unit", [unit], SI)
    if time:
        check_known(f"time {channel!r}: no unit of time", [unit], MEASURES["s"])
    return SI["pwm" if channel in CONTROLS and unit in PULSES else unit]


def misnamed(channel: str, unit: str) -> str:
    """Why a unit is odd for a channel of that name; empty where it is not."""
    si = next(si for si, row in MEASURES.items() if unit in row)
    if channel in CONTROLS:
        odd = (si == "s" and unit not in PULSES) or si == "m"  # inches: guesses are per travel
        usual = "a share of its travel (a factor in [channels.columns]), an angle or pulses"
    else:
        odd, usual = UNITS.get(channel, si) != si, UNITS.get(channel, si)
    return f"{channel} is said to be in {unit}, where {usual} is usual" if odd else ""


def units_of(stated: Mapping[str, str]) -> dict[str, str]:
    """SI unit by channel, given the units that were stated of columns; a number has its name's."""
    read_as = {unit: si for si, row in MEASURES.items() for unit in row if si != "1"}
    stated = {k: u for k, u in stated.items() if k not in CONTROLS or u not in PULSES}
    return UNITS | {name: read_as[unit] for name, unit in stated.items() if unit in read_as}


def own_units(stated: Mapping[str, str], names: Collection[str]) -> dict[str, str]:
    """Those of channels of these names that stated units make others than names say."""
    found = units_of(stated)
    return {k: found[k] for k in stated if k in names and found.get(k) != UNITS.get(k)}
