"""One nonlinear structure matched at several flight conditions at once.

Its linear structures stand side by side (`NonlinearModel.at`), each with channels of its own names,
and so do the targets: one estimation of the parameters that they share.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, cast

import numpy as np

from casid.errors import warn
from casid.estimator import Estimator
from casid.fit import Fit
from casid.free import free_parameters
from casid.frequency.duplicates import same_numbers
from casid.frequency.response import FrequencyResponse
from casid.frequency.responses import side_by_side
from casid.linear import StateSpace
from casid.matching.comparison import Comparison
from casid.matching.condition_homogeneity import discord
from casid.matching.lack_of_fit import misfit
from casid.matching.targets import Target
from casid.model import Bounds, M, Model
from casid.nonlinear.conditions import Trim, at_condition
from casid.nonlinear.coverage import joined_spans
from casid.nonlinear.model import NonlinearModel
from casid.nonlinear.trims import warn_astray
from casid.records import several
from casid.subspace.pbsid import BlackBox


def fit_at_conditions(
    estimator: Estimator,
    model: M,
    data: Mapping[Trim, Any],
    fixed: Collection[str],
    bounds: Bounds | None,
    compared: Callable[[Model, Sequence[Target]], Comparison],
    *,
    merged: bool = False,
) -> Fit[M, Any]:
    """Estimate a nonlinear structure from targets at flight conditions, ``{trim: target, ...}``.

    The result's model is the nonlinear structure; unknowns of the trims stand in its table. With
    ``merged`` the estimator is given one measured response; ``compared`` tells which points it
    uses. A `DataWarning` tells of conditions far from balance there, another of measured responses
    that contradict each other. ValueError: a linear structure, a condition that is no `Trim`, none
    at all, one target for two conditions.
    """
    if not isinstance(model, NonlinearModel):
        raise ValueError(  # noqa: TRY004 - every bad argument is a ValueError here
            f"targets at flight conditions are for a NonlinearModel; {type(model).__name__} is "
            "linear: pass its target alone"
        )
    conditions = tuple(data)
    if not conditions or not all(isinstance(each, Trim) for each in conditions):
        raise ValueError(f"conditions are {conditions}, expected {{Trim(...): target, ...}}")
    linear = model.at(*conditions)
    _check_own(data)
    targets = [
        named(target, condition, conditions)
        for condition, given in data.items()
        for target in several(given)
    ]
    chosen = [side_by_side(cast("list[FrequencyResponse]", targets))] if merged else targets
    fit = estimator.fit(linear, chosen, fixed=fixed, bounds=bounds)
    free = free_parameters(fit.model, fixed, bounds)
    active = np.array([fit.parameters[i].active for i in free.index], dtype=bool)
    own = free, active, compared(linear, chosen)
    if said := discord(*own, targets) or misfit(*own, chosen):
        warn(f"{fit.method}: {said}")
    found = model.with_values_of(fit.model)
    warn_astray(found, [each for each in conditions if not each.unknown])
    flown = joined_spans([found.reached_at(condition) for condition in conditions])
    return cast("Fit[M, Any]", replace(fit, model=found, notes=replace(fit.notes, covered=flown)))


def _check_own(data: Mapping[Trim, Any]) -> None:
    """ValueError for a target that stands at two conditions."""
    for (here, own), (there, others) in combinations(data.items(), 2):
        for one, other in product(several(own), several(others)):
            said = "are one object" if one is other else ""
            if isinstance(one, FrequencyResponse) and isinstance(other, FrequencyResponse):
                said = same_numbers(one, other, every=True) or said
            if said:
                raise ValueError(
                    f"the targets of conditions {here.name!r} and {there.name!r} {said}: what "
                    "was measured at one says nothing about the other; give each its own, or "
                    "leave one out"
                )


def named(target: Target, condition: Trim, conditions: Sequence[Trim]) -> Target:
    """A target with the names that its channels have at a condition."""
    if isinstance(target, BlackBox):
        system = cast("StateSpace", named(target.system, condition, conditions))
        return replace(target, system=system)
    inputs, outputs = (
        tuple(at_condition(name, condition, conditions) for name in names)
        for names in (target.inputs, target.outputs)
    )
    return replace(target, inputs=inputs, outputs=outputs)
