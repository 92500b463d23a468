"""Outputs as instruments measure them: away from the centre of gravity, late, with a scale.

    a_s = a + ω' × r + ω × (ω × r)        v_s = v + ω × r        y_s(t) = k y(t − τ)

of a linear structure linearised about the trim rates: ω' is the structure's own, so the rows of A
and B of p, q, r enter those of C and D. V. Klein, E. A. Morelli, Aircraft System Identification:
Theory and Practice, section 3.4; R. V. Jategaonkar, Flight Vehicle System Identification, 2nd ed.,
section 10.2.

The delay of an output is the Padé approximation [2/3] of e^(−τs), three states: |error| is below
(τω)⁶/7200, a hundredth up to τω = 2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casid.channels import FORCES, RATES, VELOCITIES
from casid.errors import ModelError

Scalar: TypeAlias = float | ca.SX

ORDER = 3  # states of one output's delay
POLES = 60.0, 36.0, 9.0  # of the Padé approximation: (τs)³ + 9 (τs)² + 36 τs + 60
ZEROS = 1.0, -0.4, 0.05  # of it: 1 − 2/5 τs + 1/20 (τs)²
AXES = {name: i for names in (FORCES, VELOCITIES) for i, name in enumerate(names)}
MOVED = "v − ω × r (a vane: that over the airspeed)"
VANES = {"alpha": (2, "w"), "beta": (1, "v")}  # the velocity that each measures, over the airspeed


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """One instrument, numbers or parameters of the structure: what it makes of an output.

    Parameters
    ----------
    x, y, z : Scalar
        Its place from the centre of gravity, in body axes: forward, right, down [m]. It counts for
        specific forces ax ay az, velocities u v w and vanes alpha beta.
    airspeed : Scalar
        Trim airspeed [m/s], of a vane that is not at the centre of gravity.
    delay : Scalar
        By how much it is late [s], above 0; the structure names the output in ``late_outputs``.
    scale : Scalar
        Factor on the output; biases are the estimators' matter.
    """

    x: Scalar = 0.0
    y: Scalar = 0.0
    z: Scalar = 0.0
    airspeed: Scalar | None = None
    delay: Scalar = 0.0
    scale: Scalar = 1.0

    def __post_init__(self) -> None:
        for name, value in ((each.name, getattr(self, each.name)) for each in fields(self)):
            if isinstance(value, ca.SX | ca.DM) or (name == "airspeed" and value is None):
                continue
            if not isinstance(value, Real) or not np.isfinite(float(value)):
                raise ModelError(
                    f"Sensor({name}={value!r}): expected a finite number or a parameter"
                )
            if name == "delay" and value < 0:
                raise ModelError(f"Sensor(delay={value!r}): expected seconds, 0 or more")


def late_states(output: str) -> tuple[str, ...]:
    """Names of the states that an output's delay adds."""
    return tuple(f"{output}_late{k}" for k in range(1, ORDER + 1))


def own_states(states: Sequence[str], outputs: Sequence[str]) -> tuple[str, ...]:
    """States that the structure itself has, without those of late outputs."""
    added = {state for output in outputs for state in late_states(output)}
    return tuple(state for state in states if state not in added)


def all_states(cls: Any) -> tuple[str, ...]:  # noqa: ANN401 - a Model, which lives above
    """States of a structure with those of its late outputs; ModelError if one is no output."""
    late: Any = cls.late_outputs
    if not isinstance(late, tuple) or not set(late) <= set(cls.outputs):
        raise ModelError(
            f"{cls.__name__}.late_outputs is {late!r}, expected a tuple of outputs: "
            f"{', '.join(cls.outputs)}"
        )
    added = [state for name in dict.fromkeys(late) for state in late_states(name)]
    return (*own_states(cls.states, cls.outputs), *added)


def measured(structure: Any, built: Mapping[str, ca.SX], found: Any) -> dict[str, ca.SX]:  # noqa: ANN401
    """Matrices A, B, C, D with the sensors ``found`` in the structure's outputs.

    ModelError: a sensor of no output, a place that means nothing for its output, a delay of an
    output that is not in ``late_outputs`` or the other way round.
    """
    outputs: tuple[str, ...] = structure.outputs
    _check(found, outputs)
    late: tuple[str, ...] = structure.late_outputs
    if hasattr(structure, "derivatives"):  # a nonlinear one: `sensed` has them in its outputs
        return dict(built)
    if not found and not late:
        return dict(built)
    states = own_states(structure.states, outputs)
    A, B, C, D = (ca.SX(built[letter]) for letter in "ABCD")
    for name, sensor in found.items():
        i = outputs.index(name)
        if any(not _zero(each) for each in (sensor.x, sensor.y, sensor.z)):
            moved = _moved(structure, name, sensor, states)
            C[i, :] += moved[0] @ A + moved[1]
            D[i, :] += moved[0] @ B
        C[i, :] *= sensor.scale
        D[i, :] *= sensor.scale
        if not _zero(sensor.delay) and name not in late:
            raise ModelError(
                f"the sensor of {name!r} has a delay; write late_outputs = ({name!r},) too"
            )
    for name in late:
        if name not in found or _zero(found[name].delay):
            raise ModelError(
                f"late_outputs names {name!r}, whose sensor has no delay above 0; give one"
            )
        A, B, C, D = _delayed(A, B, C, D, outputs.index(name), found[name].delay)
    return {"A": ca.sparsify(A), "B": ca.sparsify(B), "C": ca.sparsify(C), "D": ca.sparsify(D)}


def sensed(structure: Any, x: Sequence[Any], f: ca.SX, h: ca.SX, found: Any) -> ca.SX:  # noqa: ANN401
    """Outputs (ny,) of a nonlinear structure with the sensors ``found``, all of total values.

    Of states x, of which f (nx,) are the derivatives, and the outputs h (ny,) at the centre of
    gravity. ModelError: as `measured`, and a delay.
    """
    _check(found, structure.outputs)
    if not found:
        return h
    states, outputs = dict(zip(structure.states, range(len(x)), strict=True)), ca.vertsplit(h)
    omega, faster = (
        ca.vertcat(*[part[states[rate]] if rate in states else 0.0 for rate in RATES])
        for part in (ca.vertcat(*x), f)
    )
    for name, sensor in found.items():
        i = structure.outputs.index(name)
        if not _zero(sensor.delay):
            raise ModelError(
                f"the sensor of {name!r} has a delay, which those of nonlinear structures do not "
                "have; shift the channel of the records instead (Record.shift)"
            )
        if any(not _zero(each) for each in (sensor.x, sensor.y, sensor.z)):
            speed = _speed(name, sensor, structure.states)
            r = ca.vertcat(sensor.x, sensor.y, sensor.z)
            carried = ca.cross(omega, r)
            if name.startswith("a") and name in AXES:
                outputs[i] += (ca.cross(faster, r) + ca.cross(omega, carried))[AXES[name]]
            else:
                axis = AXES[name] if name in AXES else VANES[name][0]
                outputs[i] += carried[axis] / speed
        outputs[i] *= sensor.scale
    return ca.vertcat(*outputs)


def _check(found: Any, outputs: Sequence[str]) -> None:  # noqa: ANN401 - whatever the user wrote
    if not isinstance(found, Mapping):
        raise ModelError(f'it is {found!r}, expected sensors by output: {{"ax": Sensor(x=1.5)}}')
    for name, sensor in found.items():
        if name not in outputs:
            raise ModelError(f"it names {name!r}, which is no output: {', '.join(outputs)}")
        if not isinstance(sensor, Sensor):
            raise ModelError(f"that of {name!r} is {sensor!r}, expected Sensor(...)")


def _zero(value: Scalar) -> bool:
    """Whether this is 0 whatever the parameters are."""
    return ca.SX(value).is_zero()


def _speed(name: str, sensor: Sensor, states: Sequence[str]) -> Scalar:
    """What its place counts over: of a vane the airspeed, else 1.

    ModelError: a place that means nothing for its output, or no rate that moves it.
    """
    if not set(RATES) & set(states):
        raise ModelError(
            f"the place of the sensor of {name!r} needs the rates p, q or r among the states; "
            f"they are {', '.join(states)}: nothing turns in this structure, though the aircraft "
            "may, which the instrument feels away from the centre of gravity. Leave the place out "
            "and move the channel of the records there by measured rates ω, "
            f"{'a − ω′ × r − ω × (ω × r)' if name.startswith('a') and name in AXES else MOVED}, or "
            "take a structure with rates"
        )
    if name not in AXES and name not in VANES:
        raise ModelError(
            f"the sensor of {name!r} has a place, which means something for "
            f"{', '.join((*AXES, *VANES))} only"
        )
    if name in AXES:
        return 1.0
    if sensor.airspeed is None:
        raise ModelError(f"the vane of {name!r} has a place; give its airspeed too, that of trim")
    return sensor.airspeed


def _moved(
    structure: Any,  # noqa: ANN401 - a Model, which lives above
    name: str,
    sensor: Sensor,
    states: tuple[str, ...],
) -> tuple[ca.SX, ca.SX]:
    """What its place adds to an output: rows (1, nx) by which x' and x enter."""
    speed = _speed(name, sensor, states)
    S = ca.SX(3, len(states))  # rates p, q, r of the states
    for i, rate in enumerate(RATES):
        if rate in states:
            S[i, states.index(rate)] = 1
    r = ca.vertcat(sensor.x, sensor.y, sensor.z)
    cross = -ca.skew(r)  # ω × r = cross ω
    nothing = ca.SX(1, len(states))
    if name in AXES and name.startswith("a"):
        trim = ca.vertcat(*[float(getattr(structure, rate, 0.0)) for rate in ("P0", "Q0", "R0")])
        # ω × (ω × r) = ω (ω·r) − r (ω·ω)
        turning = trim @ r.T + ca.dot(trim, r) * ca.SX.eye(3) - 2 * r @ trim.T
        i = AXES[name]
        return cross[i, :] @ S, turning[i, :] @ S
    i = AXES[name] if name in AXES else VANES[name][0]
    return nothing, cross[i, :] @ S / speed


def _delayed(
    A: ca.SX, B: ca.SX, C: ca.SX, D: ca.SX, i: int, delay: Scalar
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Matrices with output i late."""
    n, nu = A.shape[0], B.shape[1]
    F = ca.SX(np.eye(ORDER, k=1))
    F[-1, :] = -ca.DM(POLES).T
    gain = ca.SX(ORDER, 1)
    gain[-1] = POLES[0]
    A = ca.blockcat([[A, ca.SX(n, ORDER)], [gain @ C[i, :] / delay, F / delay]])
    B = ca.vertcat(B, gain @ D[i, :] / delay)
    C = ca.horzcat(C, ca.SX(C.shape[0], ORDER))
    C[i, :] = ca.horzcat(ca.SX(1, n), ca.DM(ZEROS).T)
    D[i, :] = ca.SX(1, nu)
    return A, B, C, D
