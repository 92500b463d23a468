"""Programs that fly a card on autopilots."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from textwrap import wrap

import numpy as np

from casid.arrays import Array
from casid.errors import warn

LUA = Template(Path(__file__).with_name("ardupilot.lua.txt").read_text(encoding="utf-8"))
PYTHON = Template(Path(__file__).with_name("px4.py.txt").read_text(encoding="utf-8"))
ZERO = 2048  # of three hexadecimal digits
END_PWM = 500  # µs from a stick's middle to its end
END_UNITS = {"x": 1000, "y": 1000, "z": 500, "r": 1000}  # as much in units; z is from 0 to 1000
PERIOD = 0.02  # s between messages of a joystick
COARSE = 5  # whole µs or units below which rounding, half of one, is said: a tenth of the largest
OWN = "Written by casid"  # in every script
WIDE = 100  # characters of a line in the head
RC = 16  # channels that ArduPilot has


def check_channels(
    inputs: Iterable[str], channels: Mapping[str, tuple[int, float]], dt: float
) -> None:
    """Refuse RC channels, scales and sampling intervals [s] that ArduPilot cannot fly."""
    _check_names(inputs, channels)
    for name, (number, scale) in channels.items():
        if number not in range(1, RC + 1):
            raise ValueError(f"{name!r} on RC channel {number}; expected one of 1, 2, … {RC}")
        _check_scale(name, scale, "500 µs")
    _step(dt)


def check_axes(inputs: Iterable[str], axes: Mapping[str, tuple[str, float]]) -> None:
    """Refuse axes and scales that MANUAL_CONTROL does not have."""
    _check_names(inputs, axes)
    for name, (axis, scale) in axes.items():
        if axis not in END_UNITS:
            known = ", ".join(END_UNITS)
            raise ValueError(f"{name!r} on axis {axis!r}; MANUAL_CONTROL has {known}")
        _check_scale(name, scale, "1000")


def ardupilot_script(
    t: Array,
    r: Mapping[str, Array],
    channels: Mapping[str, tuple[int, float]],
    title: str,
    card: str,
    doubts: Sequence[str] = (),
) -> str:
    """Lua script that adds r (N,) of each input to its RC channel, in µs a unit of the card.

    The text of the card is named by its digest, its ``doubts`` are told in the head.
    """
    dt = float(np.median(np.diff(t)))
    check_channels(r, channels, dt)
    rows, furthest = [], []
    for name, (number, scale) in channels.items():
        _check_reach(name, r[name], scale, END_PWM, "µs", f"RC channel {number}")
        moved = np.rint(np.asarray(r[name]) * scale).astype(int)
        rows.append("".join(f"{value + ZERO:03x}" for value in moved))
        furthest.append(f"{{{moved.min()}, {moved.max()}}}")
    return LUA.substitute(
        title=title, own=OWN, digest=digest(card), step=_step(dt), doubts=_head(doubts, "-- "),
        seconds=f"{t[-1]:.4g}", names=", ".join(channels),
        channels=", ".join(str(number) for number, _ in channels.values()),
        furthest=", ".join(furthest), card=",\n".join(f'    "{row}"' for row in rows),
    )  # fmt: skip


def px4_script(
    t: Array,
    r: Mapping[str, Array],
    axes: Mapping[str, tuple[str, float]],
    title: str,
    card: str,
    doubts: Sequence[str] = (),
) -> str:
    """Python program that sends a card as joystick: an axis of MANUAL_CONTROL for each input.

    It takes the card of this text only, and is warned of one with samples that it would skip. The
    ``doubts`` of the card are told in the head.
    """
    check_axes(r, axes)
    if (dt := float(np.median(np.diff(t)))) < PERIOD - 1e-6:
        warn(
            f"the card's samples are {1000 * dt:.3g} ms apart, a joystick sends every "
            f"{1000 * PERIOD:g} ms and skips those between: design with dt = {PERIOD:g} s or more"
        )
    for name, (axis, scale) in axes.items():
        _check_reach(name, r[name], scale, END_UNITS[axis], "units", f"axis {axis}")
    taken = {axis: (name, float(scale)) for name, (axis, scale) in axes.items()}
    return PYTHON.substitute(
        title=title,
        doubts="\n" * bool(doubts) + _head(doubts, ""),
        own=OWN,
        digest=digest(card),
        period=f"{PERIOD:g}",
        axes=repr(taken).replace("'", '"'),
    )


def _head(doubts: Sequence[str], mark: str) -> str:
    """Lines of a comment, nothing of which ends it; "" of none."""
    plain = (" ".join(each.split()).replace("\\", "/").replace('"', "'") for each in doubts)
    return "".join(
        f"{line}\n"
        for each in plain
        for line in wrap(f"DOUBTED: {each}", WIDE, initial_indent=mark, subsequent_indent=mark)
    )


def digest(card: str) -> str:
    """What a card's text is known by: SHA-256, in hexadecimal digits."""
    return hashlib.sha256(card.encode()).hexdigest()


def is_own(script: Path) -> bool:
    """Whether a file is there and a script of a former card, not of somebody else."""
    return script.is_file() and OWN in script.read_text(encoding="utf-8", errors="replace")


def _check_reach(name: str, r: Array, scale: float, end: int, unit: str, place: str) -> None:
    """Refuse deviations (N,) that no stick can have, warn of those that rounding eats."""
    most = float(np.abs(scale * r).max())
    card = (
        f"{unit} a unit of the card (SI, from {r.min():.3g} to {r.max():.3g}; not the unit of a "
        f"log in percent or degrees), {end} for fractions from -1 to 1"
    )
    if most > end + 0.5:
        raise ValueError(
            f"{name!r} on {place} moves by {most:.0f} {unit}, a stick by {end} at most: lower its "
            f"scale, which is in {card}"
        )
    if most < COARSE:
        warn(
            f"{name!r} on {place} moves by {most:.2g} {unit} at most, which are whole numbers: "
            f"if its scale is wrong, raise it, which is in {card}; if it is right, widen the limit "
            "of the stick"
        )


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
