"""What a reader should know first: a verdict per output, and what to be careful about."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from casid.display import counted, listed
from casid.fit import AnyFit
from casid.report.content import BLACK_BOX, Caution, Content
from casid.report.evidence import COLOURED, WORSE, fed_back, noise_levels, residual_levels
from casid.unexplained_variance import unexplained
from casid.validation import Validation, judged_samples, measures

# R. Jategaonkar, Flight Vehicle System Identification, section 11: Theil's coefficient up to 0.25
# or 0.3 speaks for a good model. Below 0.1 residuals are a tenth of what is simulated. Once a trim
# is out, an output's offset from it counts as what is simulated, though a constant of the record
# makes it: what moves about its means by no more than the error is predicted poorly all the same.
GOOD, FAIR = 0.1, 0.3
NOISY = 1.2  # RMS error over standard deviation of the noise
UNJUDGED = "not judged"
FLAT = "no better than by a constant of each record"
RUNS_AWAY = "the simulation of the model diverges"
NAMED = 12  # names in a warning before it says how many more


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How well the delivered model predicts one output of all validation records together."""

    output: str
    unit: str
    rms: float
    fit: float
    theil: float
    noise: float  # standard deviation of what changes too fast for an aircraft
    residual: float  # standard deviation of what the estimation left in its own records
    records: tuple[float, ...]  # Theil's coefficient of each
    black_box: float = np.nan  # Theil's coefficient of the black box
    advantage: float = 1.0  # RMS error over that of the black box, or the noise if that is more
    fed_back: bool = False  # whether the black box predicts it as the controller's inverse
    flat: bool = False  # whether constants of the records would predict it as well

    @property
    def word(self) -> str:
        """The verdict in a word; no model predicts what hardly moves beyond its noise."""
        said = word(self.theil)
        said = "poor" if self.flat and said != UNJUDGED else said
        return UNJUDGED if said == "poor" and self.noisy else said

    @property
    def noisy(self) -> bool:
        """Whether the error is hardly more than the noise: no model could do better."""
        return self.rms <= NOISY * self.noise

    @property
    def structural(self) -> bool:
        """Whether the records allow to predict it much better than the structure does."""
        return self.advantage > WORSE and not self.fed_back

    @property
    def times(self) -> str:
        """The advantage in words."""
        least = self.rms / self.advantage
        return f"{self.advantage:.1f} times" + " (down to its noise)" * bool(
            np.isclose(least, self.noise)
        )

    @property
    def reason(self) -> str:
        """Why it is not better, in a few words."""
        if np.isinf(self.rms):
            return RUNS_AWAY
        if self.noisy:
            return "hardly more than its noise"
        if self.flat:
            return FLAT
        if self.fed_back and self.advantage > WORSE:
            return "the black box knows the controller"
        return f"the black box is {self.times} better" * self.structural

    @property
    def caution(self) -> str:
        """What to say of a poor one, or one that is not judged."""
        output = f"Output {self.output} of the validation records"
        if not np.isfinite(self.theil):
            none = (
                "no samples to compare, nothing but zeros, or most samples lie before the "
                "predictions"
            )
            return f"{output} is not judged: {none}."
        if self.word == UNJUDGED:
            return (
                f"{output} is not judged: it hardly moves beyond its noise there, and the error is "
                f"that of the noise (Theil's coefficient {self.theil:.2f}); add a record that "
                "moves it."
            )
        why = RUNS_AWAY if np.isinf(self.rms) else FLAT * self.flat
        told = f": {why}." if why else "."
        return f"{output} is predicted poorly (Theil's coefficient {self.theil:.2f}){told}"


def verdicts(validation: Validation, content: Content) -> tuple[Verdict, ...]:
    """A verdict per output of the delivered model; none without one."""
    name = content.delivered
    estimate = content.fits.get(name)
    if estimate is None:
        return ()
    residual = residual_levels(estimate)
    noise, back = noise_levels(validation.measured).tolist(), fed_back(content)
    other = BLACK_BOX if BLACK_BOX in validation.models else name
    asked = judged_samples(validation.measured, validation.begins, validation.known[name])
    pairs = zip(validation.measured, asked, strict=True)
    y = [np.where(there, record.y, np.nan) for record, there in pairs]
    found = []
    for i, output in enumerate(validation.outputs):
        rms, fit, theil = measures(validation, name, i)
        least, _, black_box = measures(validation, other, i)
        # Nobody need predict noise; what the black box lacks it does not predict better.
        floor = np.nan if np.isnan(least) else np.fmax(least, noise[i])
        verdict = Verdict(
            output=output,
            unit=content.units.get(output, ""),
            rms=rms,
            fit=fit,
            theil=theil,
            noise=noise[i],
            residual=residual.get(output, np.nan),
            records=tuple(validation.theil[name][:, i].tolist()),
            black_box=black_box,
            advantage=float(rms / floor) if 0 < floor < np.inf else 1.0,
            fed_back=output in back,
            flat=bool(unexplained([output], [each[:, [i]] for each in y], np.array([rms**2]))),
        )
        found.append(verdict)
    return tuple(found)


def word(theil: float) -> str:
    """A word for Theil's inequality coefficient."""
    if not np.isfinite(theil):
        return UNJUDGED
    if theil <= GOOD:
        return "good"
    return "fair" if theil <= FAIR else "poor"


def held_by_bounds(fit: AnyFit) -> Iterator[Caution]:
    """Parameters that their bounds hold."""
    if active := [row.name for row in fit.parameters if row.active]:
        count = counted(len(active), "parameter lies", "parameters lie")
        yield Caution(
            f"{count} on a bound: {listed(active, NAMED)}. The data ask for a value beyond it: "
            "look at the price in the table, then at the bound. Errors and bands take for granted "
            "that the truth lies within it.",
            10,
        )


def uncertain(fit: AnyFit, *, lacking: bool = False) -> Iterator[Caution]:
    """Errors that are larger than they look, and values of unknown sign.

    ``lacking`` says that the structure is known to leave dynamics out.
    """
    rows = [row for row in fit.parameters if not row.fixed and not row.active]
    ratios = [row.std_error / row.cramer_rao for row in rows if row.cramer_rao > 0]
    typical = float(np.median(ratios)) if ratios else 1.0
    if typical > COLOURED:
        left = "the structure leaves dynamics out" if lacking else "look at structure or data"
        answered = (
            ""
            if getattr(fit.notes, "K", None) is not None
            else (
                " They do not allow for a pilot or controller who reacts to what residuals hold, "
                "such as gusts or vibration, which biases estimates: compare with process_noise "
                "and with the frequency domain."
            )
        )
        yield Caution(
            f"Residuals are correlated in time: {left}. The standard errors allow for that; they "
            f"are typically {typical:.1f} times the Cramér-Rao bound.{answered}",
            40,
        )
    if unsure := [row.name for row in rows if row.std_error > abs(row.value)]:
        count = counted(len(unsure), "parameter is", "parameters is")
        yield Caution(
            f"The sign of {count} not determined (standard error above the value): "
            f"{listed(unsure, NAMED)}.",
            45,
        )
