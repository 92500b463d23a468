"""The chart beside the table of parameters: all in units of each parameter's standard error."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.fit import AnyFit, ParameterEstimate
from casid.report.words import number

REACH = 100.0  # standard errors, where the chart ends
LINEAR = 2.0  # standard errors up to which it is nearly linear; logarithmic beyond
TICKS = (-100, -10, -2, 0, 2, 10, 100)
SHAPES = ("◇", "△", "□", "▽")


@dataclass(frozen=True, kw_only=True)
class Bar:
    """One row of the chart; places in percent of its width, the estimate in the middle."""

    low: float  # of the 95 % interval
    high: float
    lower: float  # bounds
    upper: float
    zero: float
    marks: tuple[tuple[str, str, float], ...]  # name, shape and place of the other estimates
    text: str  # the same for a reader who does not see it


def sigma_place(z: float) -> float:
    """Where so many standard errors from the estimate are, in percent of the chart's width."""
    z = float(np.clip(z, -REACH, REACH))
    return float(50 + 50 * np.arcsinh(z / LINEAR) / np.arcsinh(REACH / LINEAR))


def bar(row: ParameterEstimate, others: Mapping[str, AnyFit]) -> Bar | None:
    """The chart's row of a parameter; None of one without a standard error."""
    if row.fixed or not np.isfinite(row.std_error) or row.std_error <= 0:
        return None

    def away(value: float) -> float:
        return (value - row.value) / row.std_error

    found = {name: fit[row.name].value for name, fit in others.items()}
    marks = tuple(
        (name, shape, sigma_place(away(value)))
        for (name, value), shape in zip(found.items(), SHAPES, strict=False)
    )
    edges = {"lower bound": row.lower, "upper bound": row.upper, "zero": 0.0} | found
    told = [f"{name} at {number(away(value), 2)}σ" for name, value in edges.items()]
    edge = {name: sigma_place(away(value)) for name, value in list(edges.items())[:3]}
    return Bar(
        low=sigma_place(-1.96), high=sigma_place(1.96), lower=edge["lower bound"],
        upper=edge["upper bound"], zero=edge["zero"], marks=marks, text=", ".join(told),
    )  # fmt: skip
