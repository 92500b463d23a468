"""What a report is made of: frozen values, and the sections in which stages show theirs."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.bands import ModeBand, mode_bands
from casid.channels import UNITS
from casid.consistency.reused_flights import Repeats
from casid.envelope import flight_condition, linear_fit
from casid.fit import AnyFit, Fit
from casid.model import Model
from casid.nonlinear.model import NonlinearModel
from casid.subspace.blackbox import BlackBox
from casid.undermodelling import Undermodelling, structure_error
from casid.validation import AnyModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLACK_BOX, MATCH = "black box", "H∞ match"
OUTPUT_ERROR, BASELINE = "output error", "frequency domain"
CHOSEN = "chosen step"
LEADING = 8  # rank of a caution up to which it leads
TEMPLATES = Path(__file__).parent / "templates"


def delivered(models: Collection[str]) -> str:
    """Of these names that of the model to judge and deliver."""
    return CHOSEN if CHOSEN in models else OUTPUT_ERROR


def enough(results: Mapping[str, Any]) -> bool | None:
    """Whether the black box shows the structure to be enough; None where nothing tells."""
    found = results.get("sufficiency")
    return None if found is None else bool(found.enough)


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Effort of one stage; ``kept`` says that an earlier run's result was taken."""

    stage: str
    seconds: float
    iterations: int | None = None
    cost: float | None = None
    kept: bool = False

    def __str__(self) -> str:
        """The stage and its seconds."""
        steps = "" if self.iterations is None else f", {self.iterations} iterations"
        return f"{self.stage}: {self.seconds:.1f} s{steps}"


@dataclass(frozen=True, kw_only=True)
class DataFile:
    """One record: where it came from and the digest (SHA-256) of its file."""

    role: str
    name: str
    path: str
    sha256: str
    samples: int
    seconds: float
    noise: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawing:
    """A figure of a section; ``interactive`` says that zooming into it helps."""

    name: str
    caption: str
    draw: "Callable[[], Figure]"  # when the page is written, perhaps in a process beside it
    interactive: bool = True

    @cached_property
    def figure(self) -> "Figure":
        """The figure, drawn once."""
        return self.draw()


@dataclass(frozen=True)
class Caution:
    """What makes the result less certain than it looks; the least ``rank`` is told first."""

    text: str
    rank: int = 50


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """A section of the page: what one stage shows.

    The template, in Jinja's words, knows ``content``, all of ``values``, ``figures()`` where the
    drawings go, and the filters ``number(digits)``, ``percent``, ``price`` and ``word``.
    """

    name: str  # its anchor
    title: str = ""  # its heading; without one its template opens the page, in the summary
    template: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    draw: Callable[[], Iterable[Drawing]] = tuple  # called when the page is written
    place: int = 85  # in whose order sections stand
    answer: str = ""  # for the page's first paragraph: is it good, where not, why
    lead: str = ""  # a sentence on how it was made
    cautions: tuple[Caution, ...] = ()  # for the box on top
    praise: bool = False  # whether its lead is told only where no caution contradicts it


def section(name: str, title: str, place: int, found: Any = None, **more: Any) -> Section:  # noqa: ANN401
    """A section by the package's own template of its name, which knows a result as ``found``."""
    text = (TEMPLATES / f"{name}.html.j2").read_text(encoding="utf-8")
    values = {"found": found} | more.pop("values", {})
    return Section(name=name, title=title, place=place, template=text, values=values, **more)


def cautions(content: "Content", sections: Iterable[Section]) -> tuple[str, ...]:
    """What makes the result less certain than it looks, what matters most first."""
    said = [caution for section in sections for caution in section.cautions]
    said += [Caution(text) for text in content.warnings]
    told: dict[str, str] = {}  # a stage may both warn and say so in its section, as a sentence
    for each in sorted(said, key=lambda each: each.rank):
        told.setdefault(each.text.removesuffix(".").casefold(), each.text)
    return tuple(told.values())


def contradicted(sections: Iterable[Section]) -> bool:
    """Whether a caution leads that speaks against records, structure or estimate."""
    return any(each.rank <= LEADING for section in sections for each in section.cautions)


def leads(sections: Sequence[Section]) -> tuple[str, ...]:
    """How the result was made; praise only where nothing contradicts it."""
    doubted = contradicted(sections)
    return tuple(each.lead for each in sections if each.lead and not (each.praise and doubted))


@dataclass(frozen=True, eq=False, kw_only=True)
class Content:
    """All that a report shows."""

    title: str
    model: Model  # at its guess
    results: Mapping[str, Any]  # what each stage found, by its name
    models: Mapping[str, AnyModel]  # those that simulate, by figures' name
    model_files: Mapping[str, str]  # the structure's and those it imports, with their SHA-256
    data: tuple[DataFile, ...] = ()  # every record used
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    timings: tuple[Timing, ...] = ()  # of the stages
    warnings: tuple[str, ...] = ()  # what the stages warned of
    repeats: Repeats = field(default_factory=Repeats)
    units: Mapping[str, str] = field(default_factory=lambda: UNITS)
    png: bool = False  # whether figures are written as PNG beside the SVG

    @property
    def structure(self) -> type[Model]:
        """The structure's class."""
        return type(self.model)

    @property
    def fits(self) -> dict[str, AnyFit]:
        """Structured models by the names the figures use."""
        return {name: each for name, each in self.models.items() if isinstance(each, Fit)}

    @cached_property
    def linear(self) -> "Content":
        """With fits of nonlinear structures linearised at the trim of the first validation record.

        Modes are read from it; itself where there is no such fit or record.
        """
        judged = self.results.get("validation")
        curved: dict[str, Fit[Any, Any]] = {
            name: fit for name, fit in self.fits.items() if isinstance(fit.model, NonlinearModel)
        }
        if judged is None or not curved:
            return self
        at = {n: flight_condition(fit.model, judged.measured[0]) for n, fit in curved.items()}
        flat = {name: linear_fit(fit, at[name]) for name, fit in curved.items()}
        return replace(self, models={**self.models, **flat})

    @cached_property
    def bands(self) -> dict[str, tuple[ModeBand, ...]]:
        """Modes with standard deviations of the fits that have a covariance."""
        fits = {name: fit for name, fit in self.fits.items() if fit.covariance is not None}
        return {name: mode_bands(fit, error=self.missed.get(name)) for name, fit in fits.items()}

    @cached_property
    def missed(self) -> dict[str, Undermodelling]:
        """What linear structures with a covariance miss, by a black box of the same channels."""
        box = self.results.get("pbsid")
        if not isinstance(box, BlackBox) or not box.measures:
            return {}
        known = {*box.system.inputs, *box.system.outputs}
        return {
            name: structure_error(fit, box)
            for name, fit in self.fits.items()
            if fit.covariance is not None
            and not isinstance(fit.model, NonlinearModel)
            and {*fit.model.inputs, *fit.model.outputs} <= known
        }

    @property
    def delivered(self) -> str:
        """Name of the model that is judged and delivered: the chosen step, if one was chosen."""
        return delivered(self.models)
