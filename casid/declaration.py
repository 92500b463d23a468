"""What can be wrong with a model file, told with the name of the culprit."""

from collections.abc import Callable, Collection, Iterator, Mapping, Set
from contextlib import contextmanager
from dataclasses import fields
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np

from casid import limits
from casid.checks import spelling
from casid.errors import ModelError, warn
from casid.limits import OutOfTimeError, time_limit

WIDEST = 1e12  # of a finite bound
SHARPEST = 1e-12  # of a number's size: the deviation of a prior, whose weight is its inverse square
WEIGHED = 1e-5  # of a parameter's: matches stall on sharper ones
NOTHING = "it depends on no state and no input"


def check_names(cls: type, attribute: str, names: Any) -> None:  # noqa: ANN401 - unchecked
    """Refuse what is not a tuple of different names."""
    whole = isinstance(names, tuple) and bool(names)
    if not whole or not all(isinstance(name, str) for name in names):
        raise ModelError(
            f"{cls.__name__}.{attribute} is {names!r}, expected a tuple of names: "
            f'{attribute} = ("a", "b"), or ("a",) for one'
        )
    if twice := [name for name in names if names.count(name) > 1]:
        raise ModelError(f"{cls.__name__}.{attribute} names {twice[0]!r} twice; rename one")
    for name in names:
        if not name.isprintable() or not name.strip() or set(name) & set("/\\"):
            raise ModelError(
                f"{cls.__name__}.{attribute} names {name!r}; names become parts of file names and "
                "tables: use letters, digits and underscores"
            )


def number(value: Any) -> Any:  # noqa: ANN401 - whatever the user wrote
    """A real number as a float; all else as it is, for who knows its name to refuse."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    return float(value) if isinstance(value, Real) else value


def check_number(where: str, value: Any) -> float:  # noqa: ANN401 - whatever the user wrote
    """The number that a value is; ModelError if it is none."""
    if not isinstance(found := number(value), float):
        raise ModelError(f"{where} is {value!r}, expected a real number")
    return found


def check_parameter(cls: type, name: str, declared: Any, reserved: Collection[str]) -> None:  # noqa: ANN401 - a Field
    """Refuse a parameter without type or unit, of a taken name, or with impossible bounds."""
    info, default = declared.metadata["parameter"], declared.default
    where = f"{cls.__name__}.{name}"
    if name not in cls.__annotations__:
        raise ModelError(f"{where} has no type: write {name}: Scalar = parameter(...)")
    if name in reserved:
        raise ModelError(
            f"{where}: a parameter must not have the name of a part of Model; rename it"
        )
    if not isinstance(info.unit, str) or not info.unit.strip():
        raise ModelError(f'{where} has no unit; write unit="1/s", or unit="-" if it has none')
    for what in ("lower", "upper"):
        check_number(f"{where}: {what}", getattr(info, what))
    check_number(f"{where}: default", default)
    check_order(where, info.lower, info.upper)
    if not info.lower <= default <= info.upper:
        raise ModelError(
            f"{where}: default {default:g} is outside its bounds [{info.lower:g}, {info.upper:g}]; "
            "move the guess or the bound"
        )
    if info.scale is not None and not 0 < check_number(f"{where}: scale", info.scale) < np.inf:
        raise ModelError(f"{where}: scale={info.scale}, expected a positive number")


def check_overridden(cls: Any) -> None:  # noqa: ANN401 - a structure's class
    """Refuse another value for a base's field without a type: Python would keep the old one."""
    known = {each.name: each for each in fields(cls) if each.name in vars(cls)}  # of its bases
    for name in known.keys() - cls.__annotations__.keys():
        what = "parameter(default=..., ...)" if "parameter" in known[name].metadata else "..."
        raise ModelError(
            f"{cls.__name__}.{name} has no type and would change nothing: write {name}: Scalar = "
            f"{what}, or give the value when the model is made, {cls.__name__}({name}=...)"
        )


def check_order(name: str, lower: float, upper: float) -> None:
    """Refuse bounds in the wrong order."""
    if not lower <= upper:  # also refuses NaN
        raise ModelError(f"{name}: lower bound {lower} > upper bound {upper}; swap or correct them")
    if lower == np.inf or upper == -np.inf:
        raise ModelError(
            f"{name}: no number lies within [{lower}, {upper}]; -inf and inf leave the lower and "
            "the upper bound out"
        )
    for bound in (lower, upper):
        if np.isfinite(bound) and abs(bound) > WIDEST:
            raise ModelError(
                f"{name}: a bound of {bound:g} bounds nothing physical and spoils the scale of the "
                "solver; narrow it, or leave it out"
            )


def check_pair(name: str, pair: Any) -> None:  # noqa: ANN401 - whatever the user wrote
    """Refuse what are no two bounds in order."""
    try:
        lower, upper = map(float, pair)
    except (TypeError, ValueError):
        lower, upper = np.nan, np.nan
    if np.isnan([lower, upper]).any():
        raise ModelError(
            f"{name}: bounds are {pair!r}, expected two numbers (lower, upper); -inf or inf is none"
        )
    check_order(name, lower, upper)


def check_prior(
    name: str,
    pair: Any,  # noqa: ANN401 - whatever the user wrote
    size: float = 1.0,
    sharpest: float = SHARPEST,
) -> None:
    """Refuse what is no value with a standard deviation that a number of some size can have."""
    try:
        value, std = map(float, pair)
    except (TypeError, ValueError):
        value, std = np.nan, np.nan
    if not (np.isfinite(value) and 0 < std < np.inf):
        raise ModelError(
            f"{name}: its prior is {pair!r}, expected a value and a standard deviation above 0"
        )
    if std < (least := sharpest * max(abs(value), size)):
        raise ModelError(
            f"{name}: its prior has a standard deviation of {std:g}, sharper than a solver can "
            f"weigh; fix it (fixed=), or give a deviation of {least:g} or more"
        )


def check_priors(
    model: Any,  # noqa: ANN401 - Model lives above
    priors: Mapping[str, tuple[float, float]] | None,
    fixed: Collection[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> None:
    """Refuse a prior of a fixed parameter, which nobody would read; warn of one out of bounds."""
    for name, (value, _) in (priors or {}).items():
        info = model.infos().get(name)
        if info is None:
            continue  # `free_parameters` says so
        low, high = (bounds or {}).get(name, (info.lower, info.upper))
        if name in fixed or low == high:
            raise ModelError(f"{name} is fixed and has a prior: free it, or leave the prior out")
        if not low <= value <= high:
            warn(
                f"the prior of {name}, {value:g}, lies outside its bounds [{low:g}, {high:g}]; "
                "move one of them"
            )


def check_rows(symbolic: Any, built: Mapping[str, ca.SX]) -> None:  # noqa: ANN401 - Model lives above
    """A state nothing drives and an output nothing reaches are slips, not models.

    Of a nonlinear structure its equations say so, not their slopes at one condition.
    """
    cls = type(symbolic)
    if getattr(cls, "derived", False):
        return
    nonlinear = hasattr(cls, "derivatives")
    if nonlinear:
        function = symbolic.equations()
        slopes = [[ca.SX(function.jac_sparsity(o, i), 1) for i in (0, 1)] for o in (0, 1)]
        (A, B), (C, D) = slopes
    else:
        A, B, C, D = (built[letter] for letter in "ABCD")
    for i, state in enumerate(cls.states):
        if A[i, :].nnz() + B[i, :].nnz() == 0 and state not in cls.constant_states:
            why = NOTHING if nonlinear else f"row {i} of A and of B is zero"
            raise ModelError(
                f"{cls.__name__}: state {state!r} has no dynamics: {why}; write its derivative or "
                "drop the state"
            )
    for i, output in enumerate(cls.outputs):
        if C[i, :].nnz() + D[i, :].nnz() == 0:
            why = f"the same: {NOTHING}" if nonlinear else f"zero: row {i} of C and of D is zero"
            raise ModelError(
                f"{cls.__name__}: output {output!r} is always {why}; write it or drop the output"
            )


def written(symbolic: Any, method: str, convert: Callable[[Any], Any], *arguments: Any) -> Any:  # noqa: ANN401
    """What a method of the user's class gives; whatever it raises is told with its name."""
    where = f"{type(symbolic).__name__}.{method}"
    try:
        with time_limit(limits.USER_SECONDS), _numpy_functions():
            return convert(getattr(symbolic, method)(*arguments))
    except ModelError as error:
        raise ModelError(f"{where}: {error}") from error
    except AttributeError as error:
        known = [*type(symbolic).__dataclass_fields__, *dir(type(symbolic))]
        hint = spelling(str(error.name), known)
        raise ModelError(
            f"{where} uses {error.name!r}, which {type(symbolic).__name__} does not declare{hint}"
            if error.obj is symbolic
            else f"{where} raised AttributeError: {error}"
        ) from error
    except OutOfTimeError as error:
        raise ModelError(f"{where}: {error}; does a loop never end?") from error
    except (Exception, SystemExit) as error:  # the user's own code may raise anything
        if "truth value" in str(error):  # what CasADi says of a symbol in an if
            raise ModelError(
                f"{where} decides by a parameter (if, and, or, min, max), but runs on symbols too: "
                "write casadi.if_else, casadi.fmin or casadi.fmax, or use a bound or a constraint"
            ) from error
        raise ModelError(f"{where} raised {type(error).__name__}: {error}") from error


@contextmanager
def _numpy_functions() -> Iterator[None]:
    """Let NumPy's functions of symbols give symbols, without CasADi's notice that they may change.

    What a user has chosen (``casadi.GlobalOptions.setNumpyMode``) stays.
    """
    chosen = ca.GlobalOptions.getNumpyMode()
    ca.GlobalOptions.setNumpyMode(chosen or -1)
    try:
        yield
    finally:
        ca.GlobalOptions.setNumpyMode(chosen)


def check_lengths(rows: Any) -> None:  # noqa: ANN401 - whatever the user wrote
    """Refuse what is not a sequence of rows of one length."""
    if isinstance(rows, str | Set | Mapping) or not hasattr(rows, "__len__"):
        raise ModelError(f"it is {rows!r}, expected a list of rows: [[a, b], [c, d]]")
    for i, row in enumerate(rows):
        if isinstance(row, str | Set | Mapping) or not hasattr(row, "__len__"):
            raise ModelError(f"row {i} is {row!r}, expected a list of entries: [[a, b], [c, d]]")
    lengths = [len(row) for row in rows]
    if not lengths or min(lengths) == 0:
        raise ModelError("a matrix needs at least one row and one column")
    if len(set(lengths)) > 1:
        usual = max(set(lengths), key=lengths.count)
        odd = next(i for i, length in enumerate(lengths) if length != usual)
        raise ModelError(f"row {odd} has {lengths[odd]} entries, the others have {usual}")


def check_delays(delays: Any) -> Mapping[str, Any]:  # noqa: ANN401 - whatever the user wrote
    """Refuse what does not say whose delay it is."""
    if not isinstance(delays, Mapping):
        raise ModelError(f'it is {delays!r}, expected delays by input: {{"lat": self.tau}}')
    return delays


def scalar(value: Any, what: str) -> ca.SX:  # noqa: ANN401 - whatever the user wrote
    """A number or an expression of parameters as an expression."""
    try:
        expression = ca.SX(value)
    except (NotImplementedError, TypeError, RuntimeError):
        expression = None
    if expression is None or expression.shape != (1, 1):
        hint = "; call it: add ()" if callable(value) else ""
        raise ModelError(
            f"{what} is {value!r}, expected a number or an expression of parameters{hint}"
        )
    return expression


def check_closed(where: str, expression: ca.SX, known: ca.SX) -> None:
    """Refuse symbols that are no parameters, states or inputs: ``known`` holds all that are."""
    own = {each.element_hash() for each in ca.symvar(known)}
    stray = [each.name() for each in ca.symvar(expression) if each.element_hash() not in own]
    if stray:
        raise ModelError(
            f"{where} uses the symbol {stray[0]!r}, which has no value: declare it as a parameter "
            "or a constant field of the class, or write a number in its place"
        )
