"""Programs that fly a card on autopilots."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from string import Template

import numpy as np

from casid.arrays import Array

LUA = Template(Path(__file__).with_name("ardupilot.lua.txt").read_text(encoding="utf-8"))
PYTHON = Template(Path(__file__).with_name("px4.py.txt").read_text(encoding="utf-8"))
ZERO = 2048  # of three hexadecimal digits
RC = 16  # channels that ArduPilot has
AXES = "xyzr"  # of MAVLink's MANUAL_CONTROL: pitch, roll, thrust, yaw


def check_channels(
    inputs: Iterable[str], channels: Mapping[str, tuple[int, float]], dt: float
) -> None:
    """Refuse RC channels, scales and sampling intervals [s] that ArduPilot cannot fly."""
    _check_names(inputs, channels)
    for name, (number, scale) in channels.items():
        if not 1 <= number <= RC:
            raise ValueError(f"{name!r} on RC channel {number}; expected one from 1 to {RC}")
        _check_scale(name, scale, "500 µs")
    _step(dt)


def check_axes(inputs: Iterable[str], axes: Mapping[str, tuple[str, float]]) -> None:
    """Refuse axes and scales that MANUAL_CONTROL does not have."""
    _check_names(inputs, axes)
    for name, (axis, scale) in axes.items():
        if axis not in AXES or len(axis) != 1:
            raise ValueError(f"{name!r} on axis {axis!r}; MANUAL_CONTROL has {', '.join(AXES)}")
        _check_scale(name, scale, "1000")


def ardupilot_script(
    t: Array, r: Mapping[str, Array], channels: Mapping[str, tuple[int, float]], title: str
) -> str:
    """Lua script that adds r (N,) of each input to its RC channel, in µs a unit of the input."""
    dt = float(np.median(np.diff(t)))
    check_channels(r, channels, dt)
    rows = []
    for name, (number, scale) in channels.items():
        moved = np.rint(np.asarray(r[name]) * scale).astype(int)
        if np.abs(moved).max() >= ZERO:
            raise ValueError(
                f"{name!r} on RC channel {number} moves by {np.abs(moved).max()} µs; expected a "
                f"scale in µs per unit of the input that keeps below {ZERO}"
            )
        rows.append("".join(f"{value + ZERO:03x}" for value in moved))
    return LUA.substitute(
        title=title, step=_step(dt), seconds=f"{t[-1]:.4g}", names=", ".join(channels),
        channels=", ".join(str(number) for number, _ in channels.values()),
        card=",\n".join(f'    "{row}"' for row in rows),
    )  # fmt: skip


def px4_script(r: Mapping[str, Array], axes: Mapping[str, tuple[str, float]], title: str) -> str:
    """Python program that sends a card as joystick: an axis of MANUAL_CONTROL for each input."""
    check_axes(r, axes)
    taken = {axis: (name, float(scale)) for name, (axis, scale) in axes.items()}
    return PYTHON.substitute(title=title, axes=repr(taken).replace("'", '"'))


def _step(dt: float) -> int:
    step = 1000 * dt
    if abs(step - round(step)) > 1e-6 or round(step) < 2:
        raise ValueError(
            f"the card's samples are {step:g} ms apart, ArduPilot's clock has whole milliseconds: "
            "design with dt = 0.02 s or another whole number of them"
        )
    return round(step)


def _check_scale(name: str, scale: float, usual: str) -> None:
    if not 0 < abs(scale) < np.inf:
        raise ValueError(f"the scale of {name!r} is {scale}; expected something like {usual}")


def _check_names(inputs: Iterable[str], given: Mapping[str, tuple[object, float]]) -> None:
    card = tuple(inputs)
    for name in (*given, *card):
        if name not in card or name not in given:
            raise ValueError(
                f"{name!r} is in one of card and channels only: card {', '.join(card)}; channels "
                f"{', '.join(given)}"
            )
    places = [place for place, _ in given.values()]
    if twice := [place for place in places if places.count(place) > 1]:
        raise ValueError(f"channel {twice[0]!r} is given to two inputs")
