"""A fitted model as a Python file that simulates it and needs nothing but NumPy."""

import inspect
import keyword
import pprint
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import get_args

from casid import intersample, linear
from casid.arrays import Array
from casid.channels import UNITS
from casid.exchange.delays import check_continuous
from casid.linear import StateSpace
from casid.record import Hold
from casid.textfile import write_text

# What a continuous model's simulation is made of; the file holds the very text of it.
PARTS = (linear.step_groups, *intersample.PARTS)

HEAD = Path(__file__).with_name("simulation.py.txt")


def write_module(
    path: str | Path,
    system: StateSpace,
    *,
    hold: Hold = "foh",
    title: str = "",
    units: Mapping[str, str] | None = None,
) -> None:
    """Write a model as a Python file with its matrices, delays, names, units and ``simulate``.

    Parameters
    ----------
    path : path
        Ends in ``.py``; replaced if it is there.
    system : StateSpace
        Continuous; ``fit.model.system()`` of a fit.
    hold : {"foh", "zoh"}
        What inputs do between samples where ``simulate`` is not told: of a fit, as in its records.
    title : str
        First line of the file.
    units : mapping
        Of channels in others than their names say: ``fit.units``.

    Raises
    ------
    ValueError
        A discrete model, another hold, or a file that would not be a Python module.
    """
    path = Path(path)
    named = path.stem.isidentifier() and not keyword.iskeyword(path.stem)
    if path.suffix != ".py" or not named:
        raise ValueError(f"{path}: expected a name that Python imports, such as model.py")
    if hold not in get_args(Hold):
        raise ValueError(f'hold={hold!r}, expected "foh" or "zoh"')
    write_text(path, module_text(system, hold, title or f"Simulation of {path.stem}.", units))


def module_text(
    system: StateSpace, hold: Hold, title: str, units: Mapping[str, str] | None = None
) -> str:
    """Text of the file; the title is reduced to characters that cannot end a docstring."""
    check_continuous(system)
    plain = "".join(each for each in title if each.isprintable() and each not in "\\\"'")
    names, own = (*system.states, *system.inputs, *system.outputs), {**UNITS, **(units or {})}
    head = HEAD.read_text(encoding="utf-8").format(
        title=plain, version=version("casid"), hold=hold, nx=system.nx, nu=system.nu, ny=system.ny,
        states=_literal(system.states), inputs=_literal(system.inputs),
        outputs=_literal(system.outputs),
        units=_literal({name: own[name] for name in names if name in own}),
        matrices="\n".join(f"{letter} = {_matrix(getattr(system, letter))}" for letter in "ABCD"),
        delay=system.delay.tolist(), rounding=intersample.ROUNDING,
    )  # fmt: skip
    return head + "\n\n".join(inspect.getsource(part) for part in PARTS)


def _literal(value: object) -> str:
    return pprint.pformat(value, width=100, compact=True, sort_dicts=False)


def _matrix(values: Array) -> str:
    """A matrix as text, exactly, one row a line."""
    if not values.size:
        return f"np.zeros({values.shape})"
    rows = ",\n".join(f"    {row}" for row in values.tolist())
    return f"np.array([\n{rows},\n])"
