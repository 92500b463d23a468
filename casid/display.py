"""Values that show themselves: a line in a console, a table in a notebook, a figure on demand."""

import math
import sys
from abc import abstractmethod
from collections.abc import Sequence
from importlib import import_module
from typing import Any, TextIO, TypeAlias


def digits_beside_one(value: float, least: int) -> int:
    """How many digits of a number show on which side of 1 it is."""
    known = (n for n in range(least, 18) if (float(f"{value:.{n}g}") > 1) == (value > 1))
    return next(known, least)


def counted(n: int, one: str, many: str = "") -> str:
    """A number with its noun: 1 gap, 3 gaps."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def percent_above(logarithm: float, error: float) -> tuple[float, float]:
    """A ratio's excess over 1 and its standard error [%], from those of its logarithm."""
    return 100 * math.expm1(logarithm), 100 * math.exp(logarithm) * error


class Shown:
    """A value with a headline of its own; what draws and tabulates it stands in `casid.report`."""

    @abstractmethod
    def headline(self) -> str:
        """What it is, in a line."""

    def __repr__(self) -> str:
        """Name of the class and the headline."""
        return f"{type(self).__name__}({self.headline()})"

    def _repr_html_(self) -> str:
        """Headline and table, as a notebook shows them."""
        return str(_drawn_above("tables").html(self))

    def plot(self, ax: Any = None, **choice: Any) -> Any:  # noqa: ANN401 - matplotlib stays unloaded
        """Draw it; returns the axes, an array of several.

        Parameters
        ----------
        ax : Axes or sequence of Axes
            Where; a new figure of ``matplotlib.pyplot`` unless given.
        **choice
            What to draw, where there is a choice: ``channels=("lat", "p")`` of a record,
            ``pair=("p", "lat")`` of a frequency response or a black box, ``rows=16`` of
            parameters, ``modes=True`` of an envelope, ``errors=True`` of a design.

        Raises
        ------
        ValueError
            Another number of axes than the figure has; an unknown channel.
        """
        return _drawn_above("plots").plot(self, ax, **choice)


Cells: TypeAlias = tuple[Sequence[str], Sequence[Sequence[str]]]  # heading and rows


class Tabled(Shown):
    """A value that knows its own table."""

    @abstractmethod
    def cells(self) -> Cells:
        """Heading and rows."""


class ProgressLine:
    """Writes how far a computation is, in a notebook as in a terminal.

    Iterations are written over each other, what has ended stays. Give one wherever ``progress`` is
    taken: by `identify`, `SolverOptions` and `Execution`.

    Parameters
    ----------
    file : text stream
        Standard output unless given.
    """

    def __init__(self, file: TextIO | None = None) -> None:
        self._file, self._width = file, 0

    def __call__(self, told: object) -> None:
        """Write a `Progress`, a `CampaignProgress`, a `Timing` of a stage."""
        text, passing = str(told), hasattr(told, "iteration")
        out = self._file or sys.stdout
        out.write("\r" + text.ljust(self._width) + ("" if passing else "\n"))
        out.flush()
        self._width = len(text) if passing else 0


def _drawn_above(name: str) -> Any:  # noqa: ANN401
    """A module of the report, found when asked: values know nothing of what draws them."""
    return import_module(f"casid.report.{name}")


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names in a line, the first ``most`` and how many more."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def instant(t: float) -> str:
    """An instant [s] in words: four digits, of a clock that began long before hundredths."""
    return f"{t:.4g}" if abs(t) < 1e4 else f"{t:.2f}".rstrip("0").rstrip(".")


def in_a_row(runs: Sequence[tuple[float, float, int]]) -> str:
    """Runs, each by its first and last instant [s] and how many there are, in words if any."""
    said = [f"{n} from {instant(start)} to {instant(end)} s" for start, end, n in runs]
    return f"; in a row {listed(said, 3)}" if said else ""


def in_minutes(seconds: float) -> str:
    """A length of time in words."""
    if seconds < 99.5:  # of which two digits are whole seconds
        return f"{seconds:.2g} s"
    return f"{seconds / 60:{'.2g' if seconds < 600 else '.0f'}} minutes"
