"""The stage that asks whether the structure is enough: how far it is from the black box."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from casid.checks import check_asked
from casid.display import listed
from casid.distances import Distances, distances
from casid.errors import warn
from casid.nonlinear.model import NonlinearModel
from casid.report.content import Caution, Content, Section, section
from casid.stages.stage import LeftOutError, Stage, Task

NAMED = 8  # outputs in a warning before it says how many more


@dataclass(frozen=True, kw_only=True)
class Sufficiency:
    """Settings of the distances.

    Parameters
    ----------
    band : (float, float)
        Frequencies [rad/s]; those of the match unless given, within those of the black box.
    level : float
        Chance that noise alone makes the structure look insufficient anywhere.
    """

    band: tuple[float, float] | None = None
    level: float = 0.01

    def __post_init__(self) -> None:
        check_asked(self.band, self.level)


def _run(settings: Sufficiency, task: Task) -> Distances:
    fit, box = task.results["output_error"], task.results["pbsid"]
    # The unit of all distances are the black box's errors, which one of too low an order lacks, and
    # one that feedback biases.
    if not box.measures or isinstance(fit.model, NonlinearModel):
        raise LeftOutError
    if getattr(fit.notes, "K", None) is not None and box.refinement != "prediction":
        warn(
            "whether the structure is enough was not examined: turbulence, for which a filter "
            "was fitted, biases black boxes by more than their stated errors where a controller "
            "reacts to it"
        )
        raise LeftOutError
    omega = getattr(task.settings.get("match"), "omega", None)
    low, high = box.band if omega is None else (float(min(omega)), float(max(omega)))
    usual = max(low, box.band[0]), min(high, box.band[1])
    measured = [task.results[name] for name in ("frequency",) if name in task.results]
    return distances(fit, box, measured, band=settings.band or usual, level=settings.level)


def _show(found: Distances, content: Content) -> Iterable[Section]:  # noqa: ARG001
    said, lead, answer = [], "", ""
    if found.enough:
        lead = "It misses nothing that the records show."
    else:
        outputs = list(dict.fromkeys(row.output for row in found.faults))
        more = f"; something of {listed(outputs[1:], NAMED)} too" if outputs[1:] else ""
        said = [
            Caution(
                f"The structure is not enough: {found.faults[0].told()}{more}{found.bounded}.", 1
            )
        ]
        answer = f"It is farther from the black box than errors explain: {found.sentences()[0]}."
    if found.left_out:
        far = dict.fromkeys(row.output for row in found.rows if row.far and row.fed_back)
        lead += f" Left out is what outputs feed back: {found.left_out}."
        if far:
            told = (
                f"For {listed(list(far), NAMED)} the black box cannot judge the structure where "
                f"outputs feed an input back, {found.left_out}: it is rather the inverse of the "
                "controller there."
            )
            said.append(Caution(told, 4))
    title = "Is the structure enough?"
    whole: Any = {"lead": lead.strip(), "answer": answer, "cautions": tuple(said)}
    whole["praise"] = found.enough
    yield section("sufficiency", title, 3, found, **whole)


SUFFICIENCY = Stage(
    name="sufficiency",
    does="distance of the structure to the black box",
    run=_run,
    table="sufficiency",
    settings=Sufficiency(),
    needs=("pbsid", "output_error"),
    uses=("frequency",),
    structured=True,
    kept=False,
    show=_show,
)
