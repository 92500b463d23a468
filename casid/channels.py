"""Names and units of the channels a rotorcraft usually has."""

from collections.abc import Mapping

UNITS = {
    "ax": "m/s²", "ay": "m/s²", "az": "m/s²",
    "p": "rad/s", "q": "rad/s", "r": "rad/s",
    "phi": "rad", "theta": "rad", "psi": "rad",
    "u": "m/s", "v": "m/s", "w": "m/s",
    "col": "travel", "lat": "travel", "lon": "travel", "ped": "travel",
}  # fmt: skip
CONTROLS = ("col", "lat", "lon", "ped")

READ_AS = {  # the SI unit that a column's unit becomes
    "s": "s", "ms": "s", "rad": "rad", "deg": "rad", "rad/s": "rad/s", "deg/s": "rad/s",
    "m": "m", "ft": "m", "in": "m",
    "m/s": "m/s", "ft/s": "m/s", "kt": "m/s", "km/h": "m/s",
    "m/s^2": "m/s²", "ft/s^2": "m/s²", "g": "m/s²",
}  # fmt: skip


def units_of(stated: Mapping[str, str]) -> dict[str, str]:
    """SI unit by channel, given the units that were stated of columns; a number has its name's."""
    return UNITS | {name: READ_AS[unit] for name, unit in stated.items() if unit in READ_AS}
