"""Delays of a model turned into states."""

from collections.abc import Collection, Sequence

import numpy as np
import scipy.linalg

from casid.arrays import Array, BoolArray
from casid.errors import warn
from casid.linear import StateSpace


def without_delay(system: StateSpace, pade: int | None = None) -> StateSpace:
    """The same system with its delays turned into states.

    A discrete model holds past inputs as states, which is exact; from states of zero inputs were
    zero before, whereas `StateSpace.simulate` holds their first value. A continuous one gets a Padé
    approximation for each delayed input: all-pass, the phase right up to about ``pade``/delay
    rad/s. An output with a direct term of a delayed input answers a step of that input at once by
    one of the term's full size, whatever the order; a `DataWarning` tells.

    Parameters
    ----------
    system : StateSpace
        With or without delays.
    pade : int
        Order of the approximation, 1 to 10; needed for a continuous model with delays.

    Raises
    ------
    ValueError
        Delays of a continuous model without ``pade``; of a discrete one that are no multiples of
        its interval.
    """
    if system.delay.any() and system.dt is None:
        warn_steps(system, system.D != 0, pade)
    return delays_as_states(system, pade)


def warn_steps(system: StateSpace, direct: BoolArray, pade: int | None) -> None:
    """Tell the ``direct`` terms (ny, nu) of inputs whose delay is approximated.

    A Padé approximation of as many poles as zeros passes ±1 at the highest frequencies.
    """
    if pade is not None and (told := steps_told(system, direct)):
        warn(told)


def steps_told(system: StateSpace, direct: BoolArray) -> str:
    """What `warn_steps` tells, "" of a model without such terms."""
    told = [
        f"{name} in {', '.join(y for y, felt in zip(system.outputs, column, strict=True) if felt)}"
        for name, tau, column in zip(system.inputs, system.delay, direct.T, strict=True)
        if tau and column.any()
    ]
    if not told:
        return ""
    return (
        f"direct terms of delayed inputs, {'; '.join(told)}: a Padé approximation, of whatever "
        "order, answers each step of such an input at once by one of the term's full size. "
        "Where inputs go in steps, export the model with its delay set to 0 and send them "
        "late, or write .c, or .py of a linear fit, whose delays are exact"
    )


def approximated(system: StateSpace, states: Sequence[str], pade: int | None) -> list[str]:
    """Sentences on which ``states``, the last of a model, stand for which delays."""
    late = [(name, tau) for name, tau in zip(system.inputs, system.delay, strict=True) if tau]
    if not late or pade is None:
        return []
    last = list(states)[len(states) - pade * len(late) :]
    told = (
        f"{' to '.join(dict.fromkeys((last[pade * k], last[pade * k + pade - 1])))} "
        f"that of {name}, {tau:.6g} s"
        for k, (name, tau) in enumerate(late)
    )
    reach = pade / max(tau for _, tau in late)
    return [
        f"Delays are approximated by states (Padé, order {pade}), right up to some {reach:.3g} "
        f"rad/s: {'; '.join(told)}"
    ]


def delays_as_states(system: StateSpace, pade: int | None) -> StateSpace:
    """`without_delay` without a word on steps."""
    if not system.delay.any():
        return system
    if system.dt is None and pade is None:
        told = ", ".join(
            f"{name} {tau:g} s"
            for name, tau in zip(system.inputs, system.delay, strict=True)
            if tau
        )
        raise ValueError(
            f"the model has delays ({told}), the target has none: pass pade=3 for approximations, "
            "or export a model without delays to drop them knowingly (of a StateSpace "
            "dataclasses.replace(system, delay=()))"
        )
    lines = [_delay_line(system, j, pade) for j in range(system.nu)]
    A, B, C, D = (scipy.linalg.block_diag(*blocks) for blocks in zip(*lines, strict=True))
    names = list(system.states)
    for name, line in zip(system.inputs, lines, strict=True):
        for k in range(len(line[0])):
            names.append(unused(f"{name}_{k + 1}", names))
    n = len(A)
    return StateSpace(
        np.block([[system.A, system.B @ C], [np.zeros((n, system.nx)), A]]),
        np.vstack([system.B @ D, B]),
        np.hstack([system.C, system.D @ C]),
        system.D @ D,
        system.dt,
        system.inputs,
        system.outputs,
        tuple(names),
    )


def unused(name: str, taken: Collection[str]) -> str:
    """The name, or one like it that is not taken."""
    while name in taken:
        name += "_"
    return name


def _delay_line(system: StateSpace, j: int, pade: int | None) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D of the delay of one input."""
    tau = float(system.delay[j])
    if system.dt is not None:
        n = round(tau / system.dt)
        if abs(tau - n * system.dt) > 1e-6 * system.dt:
            raise ValueError(
                f"the delay of {system.inputs[j]!r}, {tau:g} s, is no multiple of the interval "
                f"{system.dt:g} s of this discrete model"
            )
        if n:
            A = np.eye(n, k=-1)
            return A, np.eye(n, 1), np.eye(n)[-1:], np.zeros((1, 1))
    elif tau:
        if pade is None or not 1 <= pade <= 10:
            raise ValueError(f"pade={pade}: expected an order of 1 to 10")
        return _all_pass(tau, pade)
    return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))


def _all_pass(tau: float, n: int) -> tuple[Array, Array, Array, Array]:
    """The (n, n) Padé approximation of exp(-s τ) in balanced states: A + Aᵀ = -b bᵀ.

    With z = s τ/2 its denominator is zⁿ y_n(1/z), y_n Bessel's polynomials, whose recurrence
    y_k = (2k - 1) p y_{k-1} + y_{k-2} is that of the characteristic polynomials of Schwarz matrices
    F(k) in p. A companion form has entries up to (n/τ)ⁿ, and loses all digits.
    """
    k = np.arange(1, n)
    off = np.diag(1 / np.sqrt(4.0 * k**2 - 1), -1)
    F = off - off.T
    F[0, 0] = -1.0
    A = 2 / tau * np.linalg.inv(F)
    b = np.sqrt(tau) * A[:, :1]
    D = np.array([[(-1.0) ** n]])
    return A, b, -D * b.T, D


def check_continuous(system: StateSpace) -> None:
    """Refuse a discrete model: ValueError."""
    if system.dt is not None:
        raise ValueError(
            f"the model is discrete with an interval of {system.dt:g} s; convert it to continuous "
            "time first (BlackBox.continuous)"
        )
