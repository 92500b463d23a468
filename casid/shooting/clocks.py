"""Delays between inputs and outputs that may be the clocks' as well as the aircraft's.

An input recorded late by s and felt after τ acts as one delayed by τ − s: no flight tells the two
apart, but the sum is known, and a negative one cannot be the aircraft's. Inputs are moved ahead by
a margin, so that a structure whose delays are 0 or more can show it. What is known of the
aircraft's delays, by priors or constraints, is not known of these sums and does not count.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.model import Constraint, Model
from casid.records import Records, several
from casid.sensors import Scalar
from casid.shooting.output_error import OutputError
from casid.threads import one_thread

MARGIN = 0.2  # s, by which inputs may have been recorded late
SIGNIFICANT = 3.0  # standard errors
WORST = 0.005  # s, that matter


@dataclass(frozen=True, kw_only=True)
class InputDelay:
    """Delay of one input: the aircraft's and that of its clock, together [s].

    Without a standard error where it ends at the limit of what was looked for.
    """

    input: str
    parameter: str
    delay: float
    std_error: float

    @property
    def remark(self) -> str:
        """What a negative delay means, or the end of the search; empty for what may be."""
        if not np.isfinite(self.std_error):
            return (
                f"the delay of {self.input} is {self.delay:.3f} s, the limit of the search, and "
                "may lie beyond: search further, by a larger margin or other bounds of "
                f"{self.parameter}"
            )
        if self.delay > -max(WORST, SIGNIFICANT * self.std_error):
            return ""
        return (
            f"{self.input} acts {-self.delay:.3f} ± {self.std_error:.1g} s before it was recorded; "
            "no aircraft does: the clocks differ, by that and the aircraft's own delay; move "
            f"{self.input} ahead (Record.shift)"
        )


@one_thread
def input_delays(
    model: Model,
    records: Records,
    *,
    margin: float = MARGIN,
    fixed: Collection[str] = (),
    estimator: OutputError = OutputError(),
) -> tuple[InputDelay, ...]:
    """The delay of each input, negative ones too, by output error.

    Parameters
    ----------
    model : Model
        Structure and start; the inputs looked at are those whose delay is a free parameter alone.
    records : Record or sequence of Record
        Of any clocks.
    margin : float
        Largest negative delay that can be found [s].
    fixed
        As in `Estimator.fit`.
    estimator : OutputError
        Its settings, without ``responses``: their inputs are of other clocks. Priors of the delays
        and the structure's constraints on them are left out.

    Raises
    ------
    ValueError, ModelError, ConvergenceError
        No input whose delay is a parameter, and what the estimator refuses.
    """
    if not margin > 0:
        raise ValueError(f"margin={margin}: expected seconds above 0")
    tied = {name: value for name, value in _delays(model).items() if value not in fixed}
    if not tied:
        raise ModelError(
            f"{type(model).__name__} has no input whose delay is a free parameter of its own"
        )
    if estimator.responses:
        raise ValueError(
            "estimator: its responses say nothing about the records' clocks; leave them out"
        )
    infos, own = model.infos(), set(tied.values())
    bounds = {name: (-margin, infos[name].upper) for name in own}
    known = {name: pair for name, pair in (estimator.priors or {}).items() if name not in own}
    ahead = [each.shift(dict.fromkeys(tied, -margin)) for each in several(records)]
    moved = _moved(model, tied, margin)
    fit = replace(estimator, priors=known).fit(moved, ahead, fixed=fixed, bounds=bounds)
    rows = {name: fit[parameter] for name, parameter in tied.items()}
    return tuple(
        InputDelay(input=name, parameter=row.name, delay=row.value, std_error=row.std_error)
        for name, row in rows.items()
    )


def _moved(model: Model, tied: Mapping[str, str], margin: float) -> Model:
    """The model for inputs moved ahead by a margin, free of constraints on their delays."""
    cls: Any = type(model)
    names, lam = model.parameter_names(), ca.SX.sym("lam", len(model.vector()))
    slopes = ca.jacobian(model.matrices()(lam)[5], lam)
    at = [names.index(parameter) for parameter in tied.values()]
    free = [k for k in range(slopes.shape[0]) if not slopes[k, at].nnz()]

    def delays(self: Model) -> dict[str, Scalar]:
        own = cls.delays(self)
        return {name: tau + margin if name in tied else tau for name, tau in own.items()}

    def constraints(self: Model) -> Sequence[Constraint]:
        own = cls.constraints(self)
        return tuple(own[k] for k in free)

    body = {"delays": delays, "constraints": constraints, "__module__": cls.__module__}
    derived: Any = type(cls.__name__, (cls,), body | {"__doc__": cls.__doc__})
    found: Model = derived(**{each.name: getattr(model, each.name) for each in fields(model)})
    return found


def _delays(model: Model) -> dict[str, str]:
    """The parameter that is the delay of each input, of those that are one."""
    names, lam = model.parameter_names(), model.vector()
    function = model.matrices()
    tau = function(lam)[4].full().ravel()
    found = {}
    for i, name in enumerate(names):
        step = np.zeros(len(names))
        step[i] = 1e-3
        moved = function(lam + step)[4].full().ravel() - tau
        heard = np.flatnonzero(np.abs(moved) > 1e-12)
        if len(heard) == 1 and np.isclose(moved[heard[0]], 1e-3):
            found[model.inputs[heard[0]]] = name
    return found
