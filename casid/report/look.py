"""How all figures look."""

from typing import Any

LOOK: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],  # comes with matplotlib
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.titley": 1.0,  # looked for, its place takes a tenth of the time
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "xtick.bottom": False,  # the grid marks the place
    "ytick.left": False,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "casid",
    "path.simplify_threshold": 0.5,
}
WIDTH = 7.4  # inches: the printable width of A4
