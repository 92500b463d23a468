"""Settings of a black box as candidates, with their scores, and which of them was chosen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from casid.arrays import Array
from casid.display import Cells, Tabled, counted
from casid.subspace.campaign import Windows
from casid.tabulation import markdown_table
from casid.values import storable

Refinement = Literal[
    "fourier", "unrefined", "linear", "prediction", "simulation", "local simulation"
]


@storable
@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One choice of settings and its score, the lower the better."""

    order: int
    past: int
    pole: float  # [rad/s], NaN on samples
    regularisation: float
    score: float = np.nan
    error: float = 0.0  # standard error of the mean distance from the best candidate
    folds: tuple[float, ...] = ()  # scores by record (held out, or all) or stretch
    refinement: Refinement = "fourier"  # what follows the subspace estimate on samples

    @property
    def label(self) -> str:
        """What candidates of other orders share: the pole, or the refinement on samples."""
        return f"samples, {self.refinement}" if np.isnan(self.pole) else f"a = {self.pole:g} rad/s"

    @classmethod
    def of(cls, order: int, w: Windows, how: Refinement = "fourier") -> "Candidate":
        """Settings that have no score yet."""
        found = cls(order=order, past=w.past, pole=w.pole, regularisation=w.regularisation)
        return replace(found, refinement=how)

    def scored(self, values: Sequence[float] | Array) -> "Candidate":
        """The candidate with its scores fold by fold, and their mean."""
        return replace(self, score=float(np.mean(values)), folds=tuple(map(float, values)))

    @property
    def windows(self) -> Windows:
        """What its predictor is regressed with."""
        return Windows(self.past, self.past, self.pole, self.regularisation)


@storable
@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class OrderSelection(Tabled):
    """Which settings the data chose.

    Parameters
    ----------
    chosen : Candidate
        The settings.
    candidates : tuple of Candidate
        All that were tried, in that order.
    criterion : str
        "held-out records", "AICc" or, with black boxes of samples among the candidates,
        "held-out stretches": the share of their power that a simulation leaves unexplained.
    singular_values : (min(future ny, ...),) array
        Of the predicted future at the chosen pole and past.
    """

    chosen: Candidate
    candidates: tuple[Candidate, ...]
    criterion: str
    singular_values: Array

    def headline(self) -> str:
        """Order, window, pole and criterion of what was chosen."""
        c, many = self.chosen, counted(len(self.candidates), "candidate")
        return f"order {c.order}, past {c.past}, {c.label}: of {many} by {self.criterion}"

    def cells(self) -> Cells:
        """Heading, and one row a candidate."""
        rows = []
        for c in self.candidates:
            mark = " **chosen**" if c == self.chosen else ""
            score = f"{c.score:.4f} ± {c.error:.4f}{mark}"
            rows.append([str(c.order), str(c.past), c.label, f"{c.regularisation:g}", score])
        return ("order", "past", "from", "regularisation", self.criterion), rows

    def to_markdown(self) -> str:
        """The table of candidates, the chosen one marked."""
        return markdown_table(*self.cells())
