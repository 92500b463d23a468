"""Programs that fly a card on autopilots."""

from collections.abc import Mapping
from pathlib import Path
from string import Template

import numpy as np

from casid.arrays import Array

LUA = Template(Path(__file__).with_name("ardupilot.lua.txt").read_text(encoding="utf-8"))
PYTHON = Template(Path(__file__).with_name("px4.py.txt").read_text(encoding="utf-8"))
ZERO = 2048  # of three hexadecimal digits
AXES = "xyzr"  # of MAVLink's MANUAL_CONTROL: pitch, roll, thrust, yaw


def ardupilot_script(
    t: Array, r: Mapping[str, Array], channels: Mapping[str, tuple[int, float]], title: str
) -> str:
    """Lua script that adds r (N,) of each input to its RC channel, in µs a unit of the input."""
    _check_names(r, channels)
    rows = []
    for name, (number, scale) in channels.items():
        moved = np.rint(np.asarray(r[name]) * scale).astype(int)
        if number < 1 or np.abs(moved).max() >= ZERO:
            raise ValueError(
                f"{name!r} on RC channel {number} moves by {np.abs(moved).max()} µs; expected a "
                f"channel from 1 on and a scale in µs per unit of the input that keeps below {ZERO}"
            )
        rows.append("".join(f"{value + ZERO:03x}" for value in moved))
    return LUA.substitute(
        title=title, step=_step(t), seconds=f"{t[-1]:.4g}", names=", ".join(channels),
        channels=", ".join(str(number) for number, _ in channels.values()),
        card=",\n".join(f'    "{row}"' for row in rows),
    )  # fmt: skip


def px4_script(r: Mapping[str, Array], axes: Mapping[str, tuple[str, float]], title: str) -> str:
    """Python program that sends a card as joystick: an axis of MANUAL_CONTROL for each input."""
    _check_names(r, axes)
    for name, (axis, _) in axes.items():
        if axis not in AXES or len(axis) != 1:
            raise ValueError(f"{name!r} on axis {axis!r}; MANUAL_CONTROL has {', '.join(AXES)}")
    taken = {axis: (name, float(scale)) for name, (axis, scale) in axes.items()}
    return PYTHON.substitute(title=title, axes=repr(taken).replace("'", '"'))


def _step(t: Array) -> int:
    step = float(np.median(np.diff(t))) * 1000
    if abs(step - round(step)) > 1e-6 or round(step) < 2:
        raise ValueError(
            f"the card's samples are {step:g} ms apart, ArduPilot's clock has whole milliseconds: "
            "design with dt = 0.02 s or another whole number of them"
        )
    return round(step)


def _check_names(r: Mapping[str, Array], given: Mapping[str, tuple[object, float]]) -> None:
    for name in (*given, *r):
        if name not in r or name not in given:
            raise ValueError(
                f"{name!r} is in one of card and channels only: card {', '.join(r)}; channels "
                f"{', '.join(given)}"
            )
    places = [place for place, _ in given.values()]
    if twice := [place for place in places if places.count(place) > 1]:
        raise ValueError(f"channel {twice[0]!r} is given to two inputs")
