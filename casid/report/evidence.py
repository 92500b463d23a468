"""What speaks against a result: structure and data, one estimate and another, too little data."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from casid.arrays import Array
from casid.baseline.accuracy import DerividNotes
from casid.consistency.measured import white_noise
from casid.display import listed
from casid.eigenmodes import Mode, modes
from casid.fit import AnyFit
from casid.record import Record
from casid.records import datum
from casid.report.content import BLACK_BOX, Caution, Content, DataFile, enough
from casid.samples import known_mean
from casid.validation import Validation

WORSE = 2.0  # RMS error of the structure over that of the black box
APART = 4.0  # standard errors of a difference: by chance once in 16 000
WORST = 2.0  # of the guideline for J on average: what a single pair may have
PER_UNKNOWN = 20.0  # measurements
OFFSET = 3.0  # constant of a record over what is usual: it is another's
GOOD = 0.1  # of what an output moves: a constant that a verdict would feel
COLOURED = 1.5  # standard error over the Cramér-Rao bound, that of white residuals
STRANGE = 4.0  # RMS error over residual of the estimation, the median of outputs
OPEN = 0.5  # standard error of an eigenvalue over its modulus: as good as any sign
NAMED = 5  # before it says how many more
REMEDIES = {  # by whether the structure is enough
    False: "Parameters make up for what the structure lacks; try a richer structure.",
    True: "The structure could follow the black box: look at the estimate, its data and bounds.",
    None: "Look at the estimate, its data and bounds, then try a richer structure.",
}


def noise_levels(records: Sequence[Record]) -> Array:
    """Standard deviation (ny,) of what changes too fast for an aircraft, the median of records."""
    found = []
    for columns in zip(*(record.y.T for record in records), strict=True):
        known = [y[np.isfinite(y)] for y in columns]
        levels = [white_noise(y) for y in known if len(y) > 8]
        found.append(np.median(levels) if levels else np.nan)
    return np.array(found)


def residual_levels(fit: AnyFit) -> dict[str, float]:
    """Standard deviation of what an estimation left of each output in its own records."""
    left = () if fit.R is None else np.sqrt(np.diag(fit.R)).tolist()
    return dict(zip(type(fit.model).outputs, left, strict=False))


def disagreement(validation: Validation, content: Content) -> Iterator[Caution]:
    """Outputs that the records allow to predict much better than the delivered model does."""
    model = content.delivered
    if not {BLACK_BOX, model} <= set(validation.models):
        return
    sizes = [_pooled(validation.rms[name]) for name in (model, BLACK_BOX)]
    level, back, said = noise_levels(validation.measured), fed_back(content), []
    for name, own, other, floor in zip(validation.outputs, *sizes, level, strict=True):
        least = np.fmax(other, floor)  # nobody need predict noise
        if own > WORSE * least and not np.isnan(other) and name not in back:
            limit = f"{least:.2g}" + ", its noise" * bool(floor > other)
            said.append((own / least, f"{name} {own / least:.1f} times ({own:.2g} for {limit})"))
    if said:
        yield Caution(
            "Model and data disagree: the black box predicts the validation records better, "
            f"{listed([text for _, text in sorted(said, reverse=True)], NAMED)}. "
            + REMEDIES[enough(content.results)],
            5,
        )


def fed_back(content: Content) -> tuple[str, ...]:
    """Outputs that the black box predicts as the controller's inverse, as they move its inputs."""
    box = content.results.get("pbsid")
    return () if box is None else tuple(box.fed_back())


def unexplained_records(validation: Validation, content: Content) -> Iterator[Caution]:
    """Validation records that neither model explains, though one left white noise in its own.

    What a filter left of its own is of predictions a sample ahead, which no others compare with.
    """
    fit, model = content.fits.get(content.delivered), content.delivered
    if fit is None or fit.R is None or not {BLACK_BOX, model} <= set(validation.models):
        return
    if getattr(fit.notes, "K", None) is not None:
        return
    rows = [row for row in fit.parameters if not row.fixed and row.cramer_rao > 0]
    if not rows or np.median([row.std_error / row.cramer_rao for row in rows]) > COLOURED:
        return
    left = residual_levels(fit)
    size = np.array([left.get(name, np.nan) for name in validation.outputs])
    least = np.fmin(validation.rms[model], validation.rms[BLACK_BOX]) / size
    for name, ratio in zip(validation.records, np.nanmedian(least, axis=1), strict=True):
        if ratio > STRANGE:
            yield Caution(
                f"Validation record {name} is not explained as well as the identification "
                "records: another aircraft, clock, unit or trim? The smaller of both models' "
                f"errors is {ratio:.1f} times the residuals of the estimation (median over "
                "outputs).",
                4,
            )


def offsets(validation: Validation, content: Content) -> Iterator[Caution]:
    """Constants of simulated records that hide what no constant of the estimation did."""
    fit, model = content.fits.get(content.delivered), content.delivered
    if fit is None or fit.biases is None:
        return
    usual = dict(zip(fit.model.outputs, np.abs(fit.biases).max(axis=0, initial=0), strict=True))
    own = np.array([usual.get(name, np.nan) for name in validation.outputs])
    said = []
    for k, record in enumerate(validation.measured):
        if np.isfinite(validation.horizon[k]):
            continue
        moved = GOOD * np.sqrt(known_mean((record.y - datum(record)) ** 2))
        least = OFFSET * np.maximum(np.maximum(own, validation.rms[model][k]), moved / OFFSET)
        bias = validation.biases[model][k]
        sizes = [
            f"{size:.2g} {content.units.get(name, '')}".strip()
            for name, size in zip(validation.outputs, bias, strict=True)
        ]
        found = np.flatnonzero(np.abs(bias) > least)
        said += [f"{validation.outputs[j]} of {record.name} ({sizes[j]})" for j in found]
    if said:
        yield Caution(
            f"Fitted constants hide an offset of the model: {listed(said, NAMED)}, each more "
            f"than {OFFSET:g} times the error that remains and any constant of the estimation. "
            "No verdict counts them: look at trim, units and instruments of these records.",
            7,
        )


def _pooled(rms: Array) -> Array:
    """RMS errors (ny,) of all records together, from those (records, ny) of each; NaN left out."""
    known = np.ma.masked_array(rms**2, np.isnan(rms))
    return np.asarray(np.sqrt(known.mean(axis=0).filled(np.nan)))


def differences(content: Content) -> Iterator[Caution]:
    """Parameters on which two fits differ by more than their errors allow."""
    for (one, first), (other, second) in combinations(content.fits.items(), 2):
        if found := significant_differences(first, second):
            worst = sorted(found, key=found.__getitem__, reverse=True)
            opposite = sum(first[name].value * second[name].value < 0 for name in found)
            common = sum(not row.fixed for row in first.parameters)
            yield Caution(
                f"{one.capitalize()} and {other} differ by more than their errors allow on "
                f"{len(found)} of {common} parameters ({opposite} of opposite sign): "
                f"{listed([f'{name} {found[name]:.0f}σ' for name in worst], NAMED)}. Errors do not "
                "cover what the structure lacks: neither value is known to its standard error.",
                8,
            )


def comparable(one: AnyFit, other: AnyFit) -> bool:
    """Whether two fits state an error of any parameter, by which they may differ."""
    spreads = (np.hypot(row.std_error, other[row.name].std_error) for row in one.parameters)
    return any(0 < spread < np.inf for spread in spreads)


def significant_differences(one: AnyFit, other: AnyFit) -> dict[str, float]:
    """Parameters on which two fits differ by more than their errors allow: standard errors."""
    found = {}
    for row in one.parameters:
        spread = np.hypot(row.std_error, other[row.name].std_error)
        gap = abs(row.value - other[row.name].value)
        if not row.fixed and np.isfinite(spread) and spread > 0 and gap > APART * spread:
            found[row.name] = float(gap / spread)
    return found


def misfit(fit: AnyFit) -> Iterator[Caution]:
    """A frequency-domain fit whose cost is above the usual limits."""
    if not isinstance(fit.notes, DerividNotes):
        return
    limit, worst = fit.notes.guidelines.J, max(fit.notes.pairs, key=lambda pair: pair.J)
    if fit.notes.average > limit or WORST * limit < worst.J:
        yield Caution(
            f"The frequency-domain fit misses the usual limits: J is {fit.notes.average:.0f} on "
            f"average (up to {limit:.0f} is satisfactory) and {worst.J:.0f} at worst, "
            f"{worst.output} from {worst.input}.",
            12,
        )


def few_data(fit: AnyFit, content: Content) -> Iterator[Caution]:
    """Too few measurements for the unknowns, or records too short to settle slow modes."""
    roles = {file.role for file in content.data}
    role = "refinement" if "refinement" in roles else "identification"
    if not (files := [file for file in content.data if file.role == role]):
        return
    model = type(fit.model)
    measured = sum(file.samples for file in files) * len(model.outputs)
    unknowns = len(fit.free_names) + len(files) * (len(model.states) + len(model.outputs))
    if measured < PER_UNKNOWN * unknowns:
        yield Caution(
            f"Few data: {measured} measurements for {unknowns} unknowns (parameters, and initial "
            "state and biases of every record); fly more.",
            14,
        )
    if vague := [
        f"{mode.name} ({mode.words}{error})" for mode, error in _vague(fit, content, files)
    ]:
        longest, total = max(file.seconds for file in files), sum(file.seconds for file in files)
        yield Caution(
            f"Few data: records of {longest:.0f} s at most, {total:.0f} s together, leave slow "
            f"modes uncertain, {listed(vague, NAMED)}; the parameters behind these modes are "
            "poorly known.",
            14,
        )


def _vague(fit: AnyFit, content: Content, files: Sequence[DataFile]) -> Iterator[tuple[Mode, str]]:
    """Slow modes that the records leave open, with the error of the eigenvalue if it is known.

    Slow: a period, or the time constant of a real pole, is longer than any record. Those of a
    nonlinear structure are of where it was flown, as the section of modes has them.
    """
    longest, flown = max(file.seconds for file in files), content.linear
    bands, fit = flown.bands.get(content.delivered), flown.fits.get(content.delivered, fit)
    for k, mode in enumerate(modes(fit.model.system())):
        scale = mode.period if np.isfinite(mode.period) else mode.time_constant
        if not longest < scale < np.inf:
            continue
        if not bands:
            yield mode, ""
        elif (std := np.hypot(bands[k].real_std, bands[k].imag_std)) > OPEN * mode.frequency:
            yield mode, f", eigenvalue ±{100 * std / mode.frequency:.0f}%"
