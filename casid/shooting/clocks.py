"""Delays between inputs and outputs that may be the clocks' as well as the aircraft's.

An input recorded late by s and felt after τ acts as one delayed by τ − s: no flight tells the two
apart, but the sum is known, and a negative one cannot be the aircraft's. Inputs are moved ahead by
a margin, so that a structure whose delays are 0 or more can show it.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casid.errors import ModelError
from casid.model import Model
from casid.records import Records, several
from casid.shooting.output_error import OutputError
from casid.threads import one_thread

MARGIN = 0.2  # s, by which inputs may have been recorded late
SIGNIFICANT = 3.0  # standard errors
WORST = 0.005  # s, that matter


@dataclass(frozen=True, kw_only=True)
class InputDelay:
    """Delay of one input: the aircraft's and that of its clock, together [s]."""

    input: str
    parameter: str
    delay: float
    std_error: float

    @property
    def remark(self) -> str:
        """What a negative delay means; empty for one that the aircraft may have."""
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
        Its settings.

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
    infos = model.infos()
    bounds = {name: (0.0, infos[name].upper + margin) for name in tied.values()}
    start: Any = {name: getattr(model, name) + margin for name in tied.values()}
    ahead = [each.shift(dict.fromkeys(tied, -margin)) for each in several(records)]
    fit = estimator.fit(replace(model, **start), ahead, fixed=fixed, bounds=bounds)
    rows = {name: fit[parameter] for name, parameter in tied.items()}
    return tuple(
        InputDelay(
            input=name, parameter=row.name, delay=row.value - margin, std_error=row.std_error
        )
        for name, row in rows.items()
    )


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
