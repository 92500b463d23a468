"""A fitted model as a Python file that simulates it and needs nothing but NumPy."""

import inspect
import pprint
from importlib.metadata import version
from pathlib import Path

from casid import intersample, linear
from casid.arrays import Array
from casid.channels import UNITS
from casid.files import write_text
from casid.linear import StateSpace

# What a continuous model's simulation is made of; the file holds the very text of it.
PARTS = (linear.step_groups, *intersample.PARTS)

HEAD = '''"""{title}

    dx/dt = A x + B u(t - DELAY)        y = C x + D u(t - DELAY)

Written by casid {version}; needs NumPy only. The model is in perturbations about the trim it was
identified at: subtract the trim from the inputs, add it to the outputs.

    y = simulate(t, u)        t (N,) s, u (N, {nu}), y (N, {ny})
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ROUNDING = {rounding}  # of the shortest interval: what falls together so closely is one instant
STATES = {states}
INPUTS = {inputs}
OUTPUTS = {outputs}
UNITS = {units}

{matrices}
DELAY = np.array({delay})  # of each input [s]


def simulate(t, u, x0=None, hold="foh"):
    """Outputs (N, {ny}) at the instants t [s], exact for inputs held as said and then delayed.

    Parameters: t (N,) increasing, any spacing; u (N, {nu}), at rest before the first sample;
    x0 ({nx},), zero unless given; hold "foh" (straight lines between samples) or "zoh" (steps).
    """
    t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
    if u.shape != (len(t), len(INPUTS)):
        raise ValueError(f"u has shape {{u.shape}}, expected {{(len(t), len(INPUTS))}}")
    if (np.diff(t) <= 0).any() or len(t) < 2:
        raise ValueError("t: expected increasing instants [s], two or more")
    if hold not in ("foh", "zoh"):
        raise ValueError(f'hold={{hold!r}}, expected "foh" or "zoh"')
    x = np.zeros(len(STATES)) if x0 is None else np.asarray(x0, dtype=float)
    if x.shape != (len(STATES),):
        raise ValueError(f"x0 has shape {{x.shape}}, expected {{(len(STATES),)}}")
    held = delayed_input(t, u, DELAY, hold)
    widths, which = step_groups(t)
    E, P1, P2 = integrals(A, widths)
    forcing = break_forcing(held, A, B, 2 if hold == "foh" else 1)
    states = np.empty((len(t), len(STATES)))
    states[0] = x
    for k, i in enumerate(which):
        steady = P1[i] @ (B @ held.value[k]) + P2[i] @ (B @ held.slope[k])
        states[k + 1] = E[i] @ states[k] + steady + forcing[k]
    return states @ C.T + held.value @ D.T


'''


def write_module(path: str | Path, system: StateSpace, *, title: str = "") -> None:
    """Write a model as a Python file with its matrices, delays, names, units and ``simulate``.

    Parameters
    ----------
    path : path
        Ends in ``.py``; replaced if it is there.
    system : StateSpace
        Continuous; ``fit.model.system()`` of a fit.
    title : str
        First line of the file.

    Raises
    ------
    ValueError
        A discrete model, or a file that would not be a Python module.
    """
    path = Path(path)
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise ValueError(f"{path}: expected a name that Python imports, such as model.py")
    write_text(path, module_text(system, title or f"Simulation of {path.stem}."))


def module_text(system: StateSpace, title: str) -> str:
    """Text of the file; the title is reduced to characters that cannot end a docstring."""
    if system.dt is not None:
        raise ValueError(
            f"the model is discrete with an interval of {system.dt:g} s; convert it to continuous "
            "time first (BlackBox.continuous)"
        )
    plain = "".join(each for each in title if each.isprintable() and each not in "\\\"'")
    names = (*system.states, *system.inputs, *system.outputs)
    head = HEAD.format(
        title=plain,
        version=version("casid"),
        nx=system.nx,
        nu=system.nu,
        ny=system.ny,
        states=_literal(system.states),
        inputs=_literal(system.inputs),
        outputs=_literal(system.outputs),
        units=_literal({name: UNITS[name] for name in names if name in UNITS}),
        matrices="\n".join(f"{letter} = {_matrix(getattr(system, letter))}" for letter in "ABCD"),
        delay=system.delay.tolist(),
        rounding=intersample.ROUNDING,
    )
    return head + "\n\n".join(inspect.getsource(part) for part in PARTS)


def _literal(value: object) -> str:
    return pprint.pformat(value, width=100, compact=True, sort_dicts=False)


def _matrix(values: Array) -> str:
    """A matrix as text, exactly, one row a line."""
    if not values.size:
        return f"np.zeros({values.shape})"
    rows = ",\n".join(f"    {row}" for row in values.tolist())
    return f"np.array([\n{rows},\n])"
