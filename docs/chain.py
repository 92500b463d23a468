"""The chain of stages as a figure."""

from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from casid.stages.listing import STAGES

BOXES = {  # where each stands, and what it says: a stage's name or a record's role
    "identification": (0, 1.0, "records:\n3-2-1-1, sweeps"),
    "frequency_records": (0, 0.0, "records:\nsweeps"),
    "pbsid": (1, 1.0, "black box\npbsid"),
    "frequency": (1, 0.0, "frequency response\nfrequency_response"),
    "hinf": (2, 1.0, "structure, matched\nmatch"),
    "output_error": (3, 1.0, "structure, refined\noutput_error"),
    "derivid": (3, 0.0, "structure, by frequency\nderivid"),
    "validation": (4, 0.5, "unseen records\nvalidate"),
}
ARROWS = (
    ("identification", "pbsid"), ("frequency_records", "frequency"), ("pbsid", "hinf"),
    ("frequency", "hinf"), ("hinf", "output_error"), ("frequency", "derivid"),
    ("output_error", "validation"), ("derivid", "validation"),
)  # fmt: skip
HALF_WIDTH, HALF_HEIGHT = 0.41, 0.24


def _boxes(ax: Axes) -> None:
    """Boxes and arrows."""
    look = {"ha": "center", "va": "center", "fontsize": 8}
    frame = {"boxstyle": "round,pad=0.02", "edgecolor": "#0072B2", "facecolor": "#eef4f9"}
    for x, y, text in BOXES.values():
        size = {"width": 2 * HALF_WIDTH, "height": 2 * HALF_HEIGHT}
        box = FancyBboxPatch((x - HALF_WIDTH, y - HALF_HEIGHT), **size, **frame)
        ax.add_patch(box)
        ax.text(x, y, text, **look)
    for start, end in ARROWS:
        (x0, y0, _), (x1, y1, _) = BOXES[start], BOXES[end]
        tail, head = (x0 + HALF_WIDTH + 0.02, y0), (x1 - HALF_WIDTH - 0.03, y1)
        ax.annotate("", head, tail, arrowprops={"arrowstyle": "-|>", "color": "#444444"})
    ax.set(xlim=(-0.5, 4.5), ylim=(-0.35, 1.35))
    ax.axis("off")


def draw(target: Path) -> None:
    """Write the figure as SVG; a box that is no stage's is refused."""
    roles = {"identification", "frequency_records"}
    if unknown := set(BOXES) - {stage.name for stage in STAGES} - roles:
        raise SystemExit(f"no stage is called {', '.join(unknown)}")
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "casid"}):
        figure = Figure(figsize=(9.0, 2.4))
        _boxes(figure.add_axes((0, 0, 1, 1)))
        figure.savefig(target, metadata={"Date": None})
