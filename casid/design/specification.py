"""What a design of inputs is asked for: limits and settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from casid.checks import checked_fields
from casid.design.criterion import Criterion
from casid.values import storable

Method = Literal["best", "steps", "multisine"]
HIGHEST = {"draws": 1000, "spread": 1.0}  # draws are models with their responses in memory


def check_deviations(*groups: Mapping[str, float]) -> None:
    """Refuse limits that leave nothing to fly: ValueError."""
    for name, value in (pair for group in groups for pair in group.items()):
        if not value > 0:
            raise ValueError(
                f"the limit of {name!r} is {value}, which leaves nothing to fly; expected "
                "a deviation from trim above 0"
            )


def check_times(**times: float | None) -> None:
    """Refuse what is no length of time: ValueError by its name."""
    for name, value in times.items():
        if value is not None and not 0 < value < np.inf:
            raise ValueError(f"{name} = {value:g} s: expected a time above 0")


@storable
@checked_fields
@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the next flight may not exceed, as deviations from trim, SI.

    They are kept in linear models, and of a nonlinear structure in its own motion, too.

    Parameters
    ----------
    sticks : mapping
        Of every input of the model; one that is not named is refused.
    rates : mapping
        Of inputs, per second.
    responses : mapping
        Of outputs and of states, as an airspeed that is not measured.
    """

    sticks: Mapping[str, float]
    rates: Mapping[str, float] = field(default_factory=dict)
    responses: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_deviations(self.sticks, self.rates, self.responses)
        if unbounded := [name for name, value in self.sticks.items() if not value < np.inf]:
            raise ValueError(
                f"the limit of stick {unbounded[0]!r} is infinite; expected the deviation from "
                "trim that may be flown"
            )
        if not self.sticks:
            raise ValueError("no stick may move: limits need sticks={name: deviation}")
        if lone := [name for name in self.rates if name not in self.sticks]:
            raise ValueError(f"the rate of {lone[0]!r} has a limit, its deviation has none")


@checked_fields
@dataclass(frozen=True, kw_only=True)
class DesignSettings:
    """How inputs are designed.

    Parameters
    ----------
    method : {"best", "steps", "multisine"}
        What is optimised: multi-step sequences on all axes at once, orthogonal multisines, or both,
        of which the better is taken.
    criterion : {"A", "D", "E", "MV"}
        What is to be small of the standard errors over those of a single 3-2-1-1 an axis: the mean
        square, the geometric mean (of the determinant), the largest of any combination of
        parameters, the mean fourth power, which weighs the largest.
    matter : tuple of str
        Parameters that count, in what is told of the design, too; all free ones unless given.
    fixed : tuple of str or None
        Parameters that are known; those that a fit held fixed unless given.
    bounds : mapping
        Of parameters, as in `Estimator.fit`; a fit's own and the structure's unless given.
    dt : float or None
        Sampling interval of the records to come [s], to which the noise refers; 0.02 unless given.
    band : (float, float) or None
        Of multisines and sweeps [rad/s]; from two periods in the duration to three times the
        fastest mode unless given.
    step : float or None
        Time between the changes of a multi-step sequence, on average [s]. A quarter period of the
        band's upper edge unless given.
    unit : float or None
        Of the 3-2-1-1 to compare with [s]; of several the best unless given.
    rest : float
        Of trim before anything moves [s].
    iterations : int
        Of the optimisation.
    seed : int
        Of the sequence that it starts from.
    spread : float or None
        Relative error of the prior that limits are to be kept with, 1 at most; 0.2 unless given.
        Values are lognormal: it is the standard deviation of their logarithms.
    draws : int
        Models drawn from the prior that the optimisation keeps within limits; twice as many, which
        it does not see, judge it, and as many fly a nonlinear structure.
    """

    method: Method = "best"
    criterion: Criterion = "A"
    matter: tuple[str, ...] = ()
    fixed: tuple[str, ...] | None = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    dt: float | None = None
    band: tuple[float, float] | None = None
    step: float | None = None
    unit: float | None = None
    rest: float = 2.0
    iterations: int = 150
    seed: int = 0
    spread: float | None = None
    draws: int = 48

    def __post_init__(self) -> None:
        for name in ("rest", "iterations", "spread", "draws"):
            value, most = getattr(self, name), HIGHEST.get(name, np.inf)
            if value is not None and not (0 <= value <= most and value < np.inf):
                end = f", {most:g} at most" * (most < np.inf)
                raise ValueError(f"{name} = {value:.7g}: expected a finite number, 0 or more{end}")
        check_times(dt=self.dt, step=self.step, unit=self.unit)
        if self.band is not None and not 0 < self.band[0] < self.band[1]:
            raise ValueError(
                f"band = {self.band}: expected (lowest, highest), 0 < lowest < highest"
            )

    @property
    def interval(self) -> float:
        """Between samples [s]: ``dt``, or what is usual."""
        return 0.02 if self.dt is None else self.dt
