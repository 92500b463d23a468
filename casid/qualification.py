"""Pass or fail of a model by the tolerance bands of a simulator's qualification test.

A band stands around each measured time history; the model's must stay inside. ``TOLERANCES`` are
those of control responses, 14 CFR Part 60, Appendix C, Table C2A (FAA): entries 2.b.3 (hover),
2.c.1 (pitch in cruise), 2.d.1 (roll and yaw) and 2.c.3.b (az); "10 % or 2 deg/s" is read as the
larger of the two, the share taken of the largest change from the first sample so far.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.channels import UNITS, factor_of, measure
from casid.checks import check_known
from casid.display import Shown, digits_beside_one, listed
from casid.validation import Validation, judged_samples

SOURCE = "14 CFR Part 60, Appendix C, Table C2A, entries 2.b.3, 2.c.1, 2.c.3.b, 2.d.1"
TOLERANCES: Mapping[str, str] = {
    "p": "10 % or 3 deg/s",
    "q": "10 % or 2 deg/s",
    "r": "10 % or 2 deg/s",
    "phi": "10 % or 3 deg",
    "theta": "10 % or 1.5 deg",
    "psi": "10 % or 2 deg",
    "az": "0.1 g",
}
EVEN = 0.5  # chance of a true model to pass, below which the noise is named
NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
FORM = re.compile(rf"(?:{NUMBER}\s*%)?(?:\s*or\s*)?(?:{NUMBER}\s*(\S+))?")


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Half the width of a band: the larger of a share of the change, and a number in SI units."""

    output: str
    share: float
    least: float
    text: str


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Qualification(Shown):
    """How a model does in tolerance bands around what was measured.

    Parameters
    ----------
    model : str
        Its name in the validation.
    records, outputs : tuple of str
        What was judged: the outputs with a tolerance.
    tolerances : tuple of Tolerance
        One an output.
    largest : (records, outputs) array
        Largest error over half the band's width; up to 1 passes; infinite where the model runs out
        of all numbers; NaN where nothing is judged: never measured while the model says something,
        or no output of the model.
    outside : (records, outputs) array
        Share of the samples judged that are outside the band.
    width : tuple of (N, outputs) array
        Half the width of the bands in each record, SI units.
    validation : Validation
        Measured and simulated time histories.
    source : str
        Where the tolerances come from.
    chance : (records, outputs) array
        Of a true model, whose error is the noise, to pass; NaN where the noise is not known, or
        nothing is judged.
    idle : tuple of str
        Outputs with a tolerance in a table of the user that there are not.
    """

    model: str
    records: tuple[str, ...]
    outputs: tuple[str, ...]
    tolerances: tuple[Tolerance, ...]
    largest: Array
    outside: Array
    width: tuple[Array, ...]
    validation: Validation
    source: str
    chance: Array
    idle: tuple[str, ...] = ()

    @property
    def passed(self) -> BoolArray:
        """Whether all of an output's samples are inside, (records, outputs)."""
        return np.asarray(self.largest <= 1.0)

    @property
    def offset(self) -> Array:
        """Size of the fitted constants over half the width at trim, (records, outputs)."""
        columns = [self.validation.outputs.index(name) for name in self.outputs]
        size = np.abs(self.validation.biases[self.model][:, columns])
        return np.asarray(size / [band.least for band in self.tolerances])

    @property
    def excused(self) -> BoolArray:
        """What passed with a constant beyond the tolerance, (records, outputs)."""
        return np.asarray(self.passed & (self.offset > 1))

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Outputs without a tolerance."""
        return tuple(name for name in self.validation.outputs if name not in self.outputs)

    @property
    def still(self) -> tuple[str, ...]:
        """Records of which no output leaves the band about its first sample.

        A model that does nothing passes them too.
        """
        columns = [self.validation.outputs.index(name) for name in self.outputs]
        judged = ~np.isnan(self.largest)
        found = zip(self.records, self.validation.measured, self.width, judged, strict=True)
        return tuple(
            name
            for name, record, half, those in found
            if those.any() and not _left(record.y[:, columns], half)[those].any()
        )

    def headline(self) -> str:
        """Passed, failed, and what could not be judged."""
        judged, told = ~np.isnan(self.largest), ""
        if failed := self.named(judged & ~self.passed, figure=True):
            told += f"; failed: {listed(failed)}"
        if noisy := self.named(self.chance < EVEN):
            told += f"; noise alone may leave the band: {listed(noisy)}"
        if moved := self.named(self.excused):
            told += f"; passed only with a constant beyond the tolerance: {listed(moved)}"
        if self.still:
            told += f"; no measurement leaves the tolerance band around trim: {listed(self.still)}"
        if none := self.named(~judged):
            told += f"; not judged: {listed(none)}"
        if self.idle:
            told += f"; no such output: {listed(self.idle)}"
        return f"{self.model}: {int(self.passed.sum())} of {int(judged.sum())} passed{told}"

    def named(self, those: BoolArray, *, figure: bool = False) -> tuple[str, ...]:
        """Outputs of records, (records, outputs), in words, with their largest errors if asked."""
        return tuple(
            f"{self.outputs[j]} of {self.records[i]}"
            + f" ({self.largest[i, j]:.{digits_beside_one(self.largest[i, j], 3)}g})" * figure
            for i, j in zip(*np.nonzero(those), strict=True)
        )


def qualify(
    validation: Validation,
    model: str = "",
    tolerances: Mapping[str, str] = TOLERANCES,
    noise: Mapping[str, float] | None = None,
) -> Qualification:
    """Judge one model of a validation by tolerance bands.

    Parameters
    ----------
    validation : Validation
        From `validate`; pass ``horizon=inf`` there to judge simulation where a model grows.
    model : str
        Its name; the last unless given.
    tolerances : mapping
        Output and band: ``"10 % or 2 deg/s"``, ``"1.5 deg"``; those of the module unless given.
        Outputs without one are not judged, nor are samples before the first prediction.
    noise : mapping
        Standard deviation of the noise of outputs, white, where it is known; SI units.

    Raises
    ------
    ValueError
        An unknown model; a tolerance that is not understood, or of an output that there is not; no
        output with a tolerance; noise of an unknown output.
    """
    model = model or validation.models[-1]
    if model not in validation.models:
        raise ValueError(f"no model {model!r}; the validation has {', '.join(validation.models)}")
    check_tolerances(tolerances, validation.outputs)
    check_known("noise of unknown output", noise or {}, validation.outputs)
    outputs = tuple(name for name in validation.outputs if name in tolerances)
    if not outputs:
        raise ValueError(
            f"none of the outputs {', '.join(validation.outputs)} has a tolerance; there are some "
            f"for {', '.join(tolerances)}"
        )
    bands = tuple(read_tolerance(name, tolerances[name]) for name in outputs)
    columns = [validation.outputs.index(name) for name in outputs]
    level = np.array([(noise or {}).get(name, np.nan) for name in outputs])
    measured, usual = validation.measured, tolerances == TOLERANCES
    asked = judged_samples(measured, validation.begins, validation.known[model])
    records = zip(measured, validation.simulated[model], asked, strict=True)
    judged = [
        _judged(r.y[:, columns], y[:, columns], a[:, columns], bands, level) for r, y, a in records
    ]
    widths, largest, outside, chance = zip(*judged, strict=True)
    return Qualification(
        model=model,
        records=validation.records,
        outputs=outputs,
        tolerances=bands,
        largest=np.array(largest),
        outside=np.array(outside),
        chance=np.array(chance),
        width=widths,
        validation=validation,
        source=SOURCE if usual else "a table of the user",
        idle=() if usual else tuple(each for each in tolerances if each not in outputs),
    )


def _left(y: Array, half: Array) -> BoolArray:
    """Which outputs (N, n) leave a band about their first sample."""
    seen = np.isfinite(y)
    first = np.take_along_axis(y, seen.argmax(axis=0)[None], axis=0)
    return np.asarray((np.where(seen, np.abs(y - first), 0.0) > half).any(axis=0))


def check_tolerances(names: Iterable[str], outputs: Iterable[str]) -> None:
    """Refuse tolerances of outputs that there are not; the usual table may have more than are."""
    names = [name for name in names if name not in TOLERANCES]
    check_known("tolerance of unknown output", names, outputs)


def read_tolerance(output: str, text: str) -> Tolerance:
    """A tolerance from its words; ValueError where they are not understood."""
    found = FORM.fullmatch(str(text).strip())
    if found is None or not (found[1] or found[2]):
        raise ValueError(
            f'tolerance of {output!r}: {text!r}, expected "10 % or 2 deg/s" or "1.5 deg"'
        )
    if not found[2] or not float(found[2]):
        raise ValueError(
            f"tolerance of {output!r}: {text!r} has no width while nothing has changed yet; add a "
            'number, "10 % or 2 deg/s"'
        )
    least = float(found[2]) * factor_of(output, found[3])
    measured = measure(found[3])
    wanted = UNITS.get(output, measured)
    if measured != wanted:
        raise ValueError(
            f"tolerance of {output!r}: {text!r} is in {measured}, expected a unit of {wanted}"
        )
    share = float(found[1]) / 100 if found[1] else 0.0
    return Tolerance(output=output, share=share, least=least, text=text)


def _judged(
    measured: Array, y: Array, there: BoolArray, bands: Sequence[Tolerance], level: Array
) -> tuple[Array, Array, Array, Array]:
    """Of one record's outputs: half widths (N, n), then largest, outside and chance, (n,)."""
    pairs = zip(measured.T, bands, strict=True)
    width = np.column_stack([_width(x, band) for x, band in pairs])
    over = np.abs(y - measured) / width
    over[there & ~np.isfinite(over)] = np.inf  # of a model that has left every band
    empty = ~there.any(axis=0)
    largest = np.where(empty, np.nan, np.where(there, over, -1.0).max(axis=0))
    outside = (there & (over > 1.0)).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    stays = np.log(_within(width / np.maximum(level, 1e-300)))
    chance = np.where(empty, np.nan, np.exp(np.sum(stays, axis=0, where=there)))
    return width, largest, outside, chance


def _within(deviations: Array) -> Array:
    """Chance that normal noise stays within so many of its standard deviations."""
    return np.asarray(np.maximum(scipy.special.erf(deviations / np.sqrt(2)), 1e-300))


def _width(measured: Array, band: Tolerance) -> Array:
    """Half the width at every sample (N,); missing samples change nothing."""
    there = np.isfinite(measured)
    if not there.any():
        return np.full(len(measured), max(band.least, 1e-300))
    change = np.where(there, np.abs(measured - measured[there][0]), 0.0)
    return np.maximum(np.maximum(band.share * np.maximum.accumulate(change), band.least), 1e-300)
