"""A structure to start from: every axis that moves, each by itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.logs.commands import MOVES
from casid.record import Record

ANGLE = {"p": "phi", "q": "theta"}
LETTER = {"p": "L", "q": "M", "r": "N", "az": "Z"}
SMOOTH = 0.1  # s over which a rate is differentiated for a guess
ROUNDING = 1e-9  # of the largest value
STEEPEST = 30.0  # 1/s, of a guessed damping

TEMPLATE = '''\
"""The axes of {source} that move, each by itself: a structure to start from, not to end with.

{equations}

Guesses are from the log. Add what couples the axes, speeds and motors or rotor when the report says
that it is missing; models/ has structures to copy.
"""

from collections.abc import Mapping

from casid import Model, Rows, Scalar, parameter


class Axes(Model):
    """Rates after inputs, each behind a lag and a delay of its own."""

    states = {states}
    inputs = {inputs}
    outputs = {outputs}

{parameters}

    def A(self) -> Rows:
        return [
{A}
        ]

    def B(self) -> Rows:
        return [
{B}
        ]
{measured}
    def delays(self) -> Mapping[str, Scalar]:
        return {{{delays}}}
'''
MEASURED = """
    def C(self) -> Rows:
        return [
{C}
        ]

    def D(self) -> Rows:
        return [
{D}
        ]
"""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """One input and the rate (or specific force) it moves; damping and gain as guessed."""

    stick: str
    rate: str
    angle: str | None
    damping: float
    gain: float

    @property
    def state(self) -> str:
        """The rate, or the speed that goes with a specific force."""
        return "w" if self.rate == "az" else self.rate

    @property
    def names(self) -> tuple[str, str, str]:
        """Of damping, gain and delay."""
        letter = LETTER[self.rate]
        return f"{letter}{self.state}", f"{letter}{self.stick}", f"tau_{self.stick}"


def axes_structure(records: Sequence[Record], source: str) -> str:
    """A model file with the class ``Axes`` for inputs and rates that move in the records.

    ValueError: no input moves a rate that was logged.
    """
    axes = _axes(records)
    if not axes:
        raise ValueError(
            f"{source}: of the inputs {', '.join(records[0].inputs)} none is known to move a rate; "
            f"name them {', '.join(MOVES)}, or name a structure (--model)"
        )
    states = [name for axis in axes for name in (axis.state, axis.angle) if name]
    outputs = _outputs(axes)
    A, B, C, D = ({} for _ in range(4))
    for axis in axes:
        damping, gain, _ = (f"self.{name}" for name in axis.names)
        A[axis.state, axis.state] = damping
        B[axis.state, axis.stick] = gain
        if axis.angle:
            A[axis.angle, axis.state] = "1"
        if axis.rate == "az":
            C["az", "w"], D["az", axis.stick] = damping, gain
    C |= {(name, name): "1" for name in outputs if name in states}
    sticks = [axis.stick for axis in axes]
    direct = {"C": _matrix(C, outputs, states), "D": _matrix(D, outputs, sticks)}
    return TEMPLATE.format(
        source=source,
        equations="\n".join(_equation(axis) for axis in axes),
        states=_tuple(states),
        inputs=_tuple(sticks),
        outputs=_tuple(outputs),
        parameters="\n".join(_parameters(axis) for axis in axes),
        A=_matrix(A, states, states),
        B=_matrix(B, states, sticks),
        measured=MEASURED.format(**direct) if D else "",
        delays=", ".join(f'"{axis.stick}": self.{axis.names[2]}' for axis in axes),
    )


def axes_outputs(records: Sequence[Record]) -> tuple[str, ...]:
    """Outputs of the class that `axes_structure` writes."""
    return tuple(_outputs(_axes(records)))


def _axes(records: Sequence[Record]) -> list[Axis]:
    return [axis for stick in records[0].inputs if (axis := _axis(records, stick)) is not None]


def _outputs(axes: Sequence[Axis]) -> list[str]:
    return [axis.rate for axis in axes] + [axis.angle for axis in axes if axis.angle]


def _axis(records: Sequence[Record], stick: str) -> Axis | None:
    rate = MOVES.get(stick)
    if rate is None or rate not in records[0].outputs:
        return None
    u, x = ([record.channel(name) for record in records] for name in (stick, rate))
    if not any(_moves(each) for each in u) or not any(_moves(each) for each in x):
        return None
    angle = ANGLE.get(rate)
    angle = angle if angle in records[0].outputs else None
    damping, gain = _guess(u, x, records[0].dt, force=rate == "az")
    return Axis(stick=stick, rate=rate, angle=angle, damping=damping, gain=gain)


def _moves(x: Array) -> bool:
    """Whether a channel does more than the rounding of a filter that it went through."""
    x = x[np.isfinite(x)]
    return bool(len(x) and np.ptp(x) > ROUNDING * np.abs(x).max())


def _guess(
    u: Sequence[Array], x: Sequence[Array], dt: float, *, force: bool
) -> tuple[float, float]:
    """Damping [1/s] and gain by least squares of x' = damping x + gain u; of a force, its gain."""
    n = max(1, round(SMOOTH / dt))
    left, right = [], []
    for stick, rate in zip(u, x, strict=True):
        smooth = [
            np.convolve(each - np.nanmean(each), np.ones(n) / n, "valid") for each in (stick, rate)
        ]
        left.append(np.column_stack(smooth[::-1]))
        right.append(smooth[1] if force else np.gradient(smooth[1], dt))
    X, y = np.vstack(left), np.concatenate(right)
    known = np.isfinite(X).all(axis=1) & np.isfinite(y)
    if force:
        return -1.0, float(np.linalg.lstsq(X[known, 1:], y[known], rcond=None)[0][0])
    damping, gain = np.linalg.lstsq(X[known], y[known], rcond=None)[0]
    return float(np.clip(damping, -STEEPEST, -0.1)), float(gain)


def _equation(axis: Axis) -> str:
    damping, gain, delay = axis.names
    after = f"{damping} {axis.state} + {gain} {axis.stick}(t - {delay})"
    if axis.rate == "az":
        return f"    w' = az = {after}"
    return f"    {axis.state}' = {after}" + f"        {axis.angle}' = {axis.state}" * bool(
        axis.angle
    )


def _parameters(axis: Axis) -> str:
    damping, gain, delay = axis.names
    reach = float(f"{20 * max(abs(axis.gain), 1e-3):.1g}")
    unit = "m/s^2" if axis.rate == "az" else "rad/s^2"
    line = "    {}: Scalar = parameter(default={:.3g}, lower={:.3g}, upper={:.3g}, unit={!r})"
    return "\n".join(
        (
            line.format(damping, axis.damping, -100.0, 0.0, "1/s"),
            line.format(gain, axis.gain, -reach, reach, unit),
            line.format(delay, 0.05, 0.0, 0.5, "s"),
        )
    )


def _matrix(
    entries: dict[tuple[str, str], str], rows: Sequence[str], columns: Sequence[str]
) -> str:
    lines = (", ".join(entries.get((row, column), "0") for column in columns) for row in rows)
    return "\n".join(
        f"            [{line}],  # {row}" for row, line in zip(rows, lines, strict=True)
    )


def _tuple(names: Sequence[str]) -> str:
    return "(" + ", ".join(f'"{name}"' for name in names) + ",)"
