"""What a report is made of: frozen values only, nothing computed here."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from casid.bounds.compare import BoundsComparison
from casid.channels import UNITS
from casid.consistency.kinematics import KinematicCheck
from casid.fit import AnyFit
from casid.frequency.estimation import FrequencyResponse
from casid.subspace.pbsid import BlackBox
from casid.validation import Validation

BLACK_BOX, MATCH, OUTPUT_ERROR, BASELINE = (
    "black box",
    "H∞ match",
    "output error",
    "frequency domain",
)


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Effort of one stage; ``kept`` says that an earlier run's result was taken."""

    stage: str
    seconds: float
    iterations: int | None = None
    cost: float | None = None
    kept: bool = False


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
class Content:
    """All that a report shows.

    Parameters
    ----------
    title : str
        Heading.
    black_box : BlackBox
        Result of the first stage.
    quadratic, hinf, output_error : Fit
        Results of the others.
    baseline : Fit or None
        The frequency-domain fit.
    frequency_response : FrequencyResponse or None
        What was measured.
    comparison : BoundsComparison or None
        What the study's cases cost.
    validation : Validation
        Of the models on unseen records, under the names of this module.
    kinematics : KinematicCheck or None
        Whether the channels of the records agree with each other.
    data : tuple of DataFile
        Every record used.
    settings, versions : mapping
        Name and value, as text.
    timings : tuple of Timing
        Of the stages.
    warnings : tuple of str
        What the stages warned of.
    units : mapping
        SI unit by channel.
    model_file : path
        Where the structure stands.
    model_digest : str
        SHA-256 of that file.
    """

    title: str
    black_box: BlackBox
    quadratic: AnyFit
    hinf: AnyFit
    output_error: AnyFit
    validation: Validation
    model_file: Path
    model_digest: str
    baseline: AnyFit | None = None
    frequency_response: FrequencyResponse | None = None
    comparison: BoundsComparison | None = None
    kinematics: KinematicCheck | None = None
    data: tuple[DataFile, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    timings: tuple[Timing, ...] = ()
    warnings: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=lambda: UNITS)

    @property
    def fits(self) -> dict[str, AnyFit]:
        """Structured models by the names the figures use."""
        fits = {MATCH: self.hinf, OUTPUT_ERROR: self.output_error}
        return fits if self.baseline is None else fits | {BASELINE: self.baseline}
