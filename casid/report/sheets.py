"""The axes that values draw themselves on: those given, or those of a new figure."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes

from casid.report.look import LOOK, WIDTH


@contextmanager
def styled() -> Iterator[None]:
    """The package's style, without loss of what the backend sets when it is loaded."""
    # The first figure of a notebook loads its backend; within rc_context the end of that would
    # undo what it sets, `interactive` above all, and no later figure would be shown.
    plt.draw_if_interactive()  # type: ignore[no-untyped-call]
    with rc_context(LOOK):
        yield


def new_axes(ax: Any, rows: int, columns: int, *, height: float) -> Any:  # noqa: ANN401
    """The axes given, if there are as many as needed; else those of a new figure, in one row."""
    if ax is None:
        size = WIDTH, 0.6 + height * rows
        _, made = plt.subplots(
            rows, columns, sharex=rows > 1, squeeze=False, figsize=size, layout="constrained"
        )
        return made.ravel()
    given = np.atleast_1d(np.asarray(ax, dtype=object)).ravel()
    if strange := [each for each in given if not isinstance(each, Axes)]:
        raise ValueError(f"ax holds {strange[0]!r}, expected Axes, as plt.subplots makes them")
    if len(given) != rows * columns:
        raise ValueError(
            f"this figure has {rows * columns} axes, {len(given)} given: pass plt.subplots({rows}, "
            f"{columns})[1], none, or choose less to draw"
        )
    return given


def as_given(ax: Any, axes: Any) -> Any:  # noqa: ANN401
    """As the axes were given: one alone, or an array."""
    return axes[0] if isinstance(ax, Axes) or len(axes) == 1 else axes


def known(wanted: Sequence[str], names: Sequence[str]) -> Sequence[str]:
    """What was asked for, all if nothing was."""
    if missing := [name for name in wanted if name not in names]:
        raise ValueError(f"no channel {missing[0]!r}; there are {', '.join(names)}")
    return wanted or names
