"""What a reader should know first: a verdict per output, and what to be careful about."""

from dataclasses import dataclass

import numpy as np

from casid.fit import AnyFit
from casid.report.content import OUTPUT_ERROR, Content
from casid.shooting.precision import OutputErrorNotes
from casid.validation import fit_percent, rms_error, theil_coefficient

# R. Jategaonkar, Flight Vehicle System Identification, section 11: Theil's coefficient up to 0.25
# or 0.3 speaks for a good model. Below 0.1 residuals are a tenth of what is simulated.
GOOD, FAIR = 0.1, 0.3
NOISY = 1.2  # RMS error over standard deviation of the noise
GAP = 0.01  # of the certificate, relative
COLOURED = 1.5  # standard error for coloured residuals over that for white ones
NAMED = 12  # names in a warning before it says how many more


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How well the refined model predicts one output of the unseen records, taken together.

    ``records`` has Theil's coefficient of each of them, ``noise`` is the standard deviation of the
    noise in the records of the estimation (NaN if unknown).
    """

    output: str
    unit: str
    rms: float
    fit: float
    theil: float
    noise: float
    records: tuple[float, ...]

    @property
    def word(self) -> str:
        """The verdict in a word."""
        return word(self.theil)

    @property
    def noisy(self) -> bool:
        """Whether the error is hardly more than the noise: no model could do better."""
        return self.rms <= NOISY * self.noise


def verdicts(content: Content) -> tuple[Verdict, ...]:
    """A verdict per output of the refined model."""
    validation, estimate = content.validation, content.output_error
    deviations = () if estimate.R is None else np.sqrt(np.diag(estimate.R)).tolist()
    noise = dict(zip(type(estimate.model).outputs, deviations, strict=False))
    found = []
    for i, output in enumerate(validation.outputs):
        y = np.concatenate([record.y[:, i] for record in validation.measured])
        y_model = np.concatenate([each[:, i] for each in validation.simulated[OUTPUT_ERROR]])
        there = np.isfinite(y) & np.isfinite(y_model)
        rms, fit, theil = (
            measure(y[there], y_model[there]) if there.any() else np.nan
            for measure in (rms_error, fit_percent, theil_coefficient)
        )
        each = tuple(float(value) for value in validation.theil[OUTPUT_ERROR][:, i])
        found.append(Verdict(output=output, unit=content.units.get(output, "-"), rms=rms, fit=fit,
                             theil=theil, noise=noise.get(output, np.nan),
                             records=each))  # fmt: skip
    return tuple(found)


def word(theil: float) -> str:
    """A word for Theil's inequality coefficient."""
    if not np.isfinite(theil):
        return "not judged"
    if theil <= GOOD:
        return "good"
    return "fair" if theil <= FAIR else "poor"


def cautions(content: Content) -> tuple[str, ...]:
    """What makes the result less certain than it looks."""
    said = list(content.black_box.doubts())
    said += [f"{fit.method}: {fit.status}" for fit in content.fits.values() if not fit.success]
    if content.kinematics is not None:
        said += [f"Kinematics: {remark}." for remark in content.kinematics.remarks]
    said += _bounds(content.output_error)
    said += _uncertain(content.output_error)
    said += _certificate(content.hinf)
    poor = [v for v in verdicts(content) if v.word in ("poor", "not judged")]
    said += [f"Output {v.output} of the unseen records is predicted poorly "
             f"(Theil's coefficient {v.theil:.2f})"
             + (", but its error is that of the noise: it hardly moves." if v.noisy else ".")
             for v in poor]  # fmt: skip
    return (*said, *content.warnings)


def _bounds(fit: AnyFit) -> list[str]:
    active = [row.name for row in fit.parameters if row.active]
    if not active:
        return []
    return [
        f"{_count(len(active), 'parameter lies', 'parameters lie')} on a bound: {_names(active)}. "
        "The data ask for a value beyond it: look at the price in the table, then at the bound."
    ]


def coloured(fit: AnyFit) -> dict[str, float]:
    """Standard errors of the free parameters that allow for residuals correlated in time."""
    if not isinstance(fit.notes, OutputErrorNotes):
        return {}
    return dict(zip(fit.free_names, fit.notes.std_error_coloured.tolist(), strict=True))


def _uncertain(fit: AnyFit) -> list[str]:
    rows = [row for row in fit.parameters if not row.fixed and not row.active]
    errors = {row.name: row.std_error for row in rows}
    wider = {name: error for name, error in coloured(fit).items() if errors.get(name, 0.0) > 0}
    said = []
    typical = np.median([error / errors[name] for name, error in wider.items()]) if wider else 1.0
    if typical > COLOURED:
        said.append(
            "Residuals are correlated in time: quote the standard errors called coloured, "
            f"typically {typical:.1f} times the others."
        )
    unsure = [row.name for row in rows
              if max(row.std_error, wider.get(row.name, 0.0)) > abs(row.value)]  # fmt: skip
    if unsure:
        said.append(
            f"The sign of {_count(len(unsure), 'parameter is', 'parameters is')} not determined "
            f"(standard error above the value): {_names(unsure)}."
        )
    return said


def _certificate(fit: AnyFit) -> list[str]:
    certificate = fit.certificate
    if certificate is None or certificate.upper_bound <= (1 + GAP) * certificate.grid_norm:
        return []
    return [
        f"The H∞ norm is known to {certificate.upper_bound / certificate.grid_norm - 1:.1%} only: "
        f"{certificate.grid_norm:.4g} on the grid, at most {certificate.upper_bound:.4g} between."
    ]


def _count(n: int, one: str, many: str) -> str:
    return f"{n} {one if n == 1 else many}"


def _names(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
