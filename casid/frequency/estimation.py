"""Frequency responses estimated from records.

M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed. (*T&R*); what
its programs FRESPID, MISOSA and COMPOSITE do is one function here, `frequency_response`. The
spectra themselves are computed in `casid.frequency.spectra`, which also lists the departures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.autoregression import filled
from casid.checks import checked_fields
from casid.errors import warn
from casid.fingerprints import fingerprint
from casid.frequency import sampling
from casid.frequency.composite import composite
from casid.frequency.differing import differing
from casid.frequency.estimate import Estimate
from casid.frequency.feedback import NoiseInInputs, noise_in_inputs
from casid.frequency.response import FrequencyResponse
from casid.frequency.spectra import (
    MEANINGLESS,
    SUSPECT,
    Conditioned,
    condition,
    record_spectra,
)
from casid.record import Record
from casid.records import Records, same_channels, standard_deviations, still, stretches
from casid.slow_sources import tell_repeats
from casid.threads import one_thread

KEPT = 0.5  # share of an input's power in windows without long losses, of all records

Method: TypeAlias = Literal["local", "windows"]


@checked_fields
@dataclass(frozen=True, eq=False, kw_only=True)
class SpectralAnalysis:
    """Frequency responses by local models, or by averaged spectra as CIFER has them.

    Local rational models of the records' transforms (`casid.frequency.local`) estimate the response
    together with what windows leak; their errors are about half those of averaged spectra.

    Coherence, and whether the inputs can be told apart, are those of averaged spectra either way:
    over Hann windows of all records, overlapped by two thirds; the inputs are separated by
    ``solve(Guu, Guy)`` at every frequency (conditioning on the other inputs); window lengths are
    merged point by point into a composite that trusts each where its random error is small.

    Parameters
    ----------
    omega : (K,) array
        Frequencies [rad/s], increasing, in any spacing. Unless given, 40 from two periods in the
        longest window to the highest that the records excite from outside. What noise that a
        controller feeds back adds to a response is part of ``leakage``; where that is half of it,
        and where nothing else moves an input, the response is NaN, unless by a ``reference``.
    windows : sequence of float
        Window lengths [s]. Unless given, five between 20 periods of the highest frequency and
        min(half the longest record, a fifth of all records together), T&R section 10.3.
    method : {"local", "windows"}
        What the response comes from. Averaged spectra ("windows") are all there is where
        ``conditioned`` is False; elsewhere what tells them from local models counts as leakage.
    conditioned : bool
        False takes every pair by itself, as if the other inputs did not move.
    reference : sequence of str
        Channels recorded outside the loop, as many as inputs: test signals or set points that noise
        does not drive. In closed loop the inputs carry the outputs' noise, which biases a response
        estimated from them towards that of the controller; G = Φ_yr Φ_ur⁻¹ (the joint input-output
        approach) is free of that. Errors are larger where the references move the inputs little;
        where that is no more than chance, or noise is fed back into them, the response is NaN.
    """

    omega: Array | None = None
    windows: Sequence[float] | None = None
    method: Method = "local"
    conditioned: bool = True
    reference: Sequence[str] = ()

    @one_thread
    def fit(self, records: Records) -> FrequencyResponse:
        """Frequency response of the records; see `frequency_response`."""
        flown = stretches(records)
        inputs, outputs = self._channels(flown)
        plain = [record.select(inputs, outputs) for record in flown]
        ends = self._ends(flown, inputs, outputs)
        grid = sampling.default_grid(plain, ends) if self.omega is None else self.omega
        omega = sampling.checked_grid(grid, plain)
        even = [sampling.equidistant(record, omega[-1]) for record in flown]
        records = [record.select(inputs, outputs) for record in even]
        lengths = sampling.checked_windows(self.windows, records, omega)
        silent = still(records, (*inputs, *outputs))
        active = [i for i, name in enumerate(inputs) if name not in silent]
        if not active:
            raise ValueError(
                f"no input moves in any record ({', '.join(inputs)}): nothing excites the aircraft"
            )
        moving = self._moving(even, [inputs[i] for i in active], outputs)
        lengths, parts, counted = _parts(moving, omega, lengths, self)
        usable = _usable(omega, lengths, parts, counted)
        merged = composite(parts, usable)
        su, sy = standard_deviations(records)
        heard = [i for i, name in enumerate(outputs) if name not in silent]
        laid = partial(_laid, where=np.ix_(heard, active), shape=(len(outputs), len(inputs)))
        multiple = np.where(np.isin(outputs, silent), np.nan, merged.multiple_coherence)
        noise = self._noise(moving, omega)
        estimate = Estimate.of_windows(merged, parts, usable, lengths, omega, noise)
        if self.conditioned:
            local = estimate.refined(
                moving, omega, heard, noise, len(self.reference), min(ends.values(), default=np.inf)
            )
            estimate = local if self.method == "local" else estimate.compared(local)
        estimate, lost = estimate.under_feedback(
            omega, [ends.get(inputs[i], np.inf) for i in active]
        )
        found = FrequencyResponse(
            omega=omega, G=laid(estimate.G), coherence=laid(estimate.coherence),
            random_error=laid(estimate.random_error), leakage=laid(estimate.leakage),
            resolution=laid(estimate.resolution),
            **_correlations(estimate, active, len(inputs)),
            inputs=inputs, outputs=outputs, input_std=su, output_std=sy,
            multiple_coherence=multiple, condition=merged.condition,
            windows=tuple(lengths),
            flags=_flags(
                omega, lengths[-1], usable, counted,
                merged.condition if self.conditioned else np.ones(len(omega)),
            )
            | _listed({why.format(inputs[i]): np.asarray(gone[:, heard, k].any(axis=1))
                       for why, gone in lost.items() for k, i in enumerate(active)}),
            records=tuple(record.name for record in records),
            fingerprints=tuple(fingerprint(record) for record in plain), printed=(),
        )  # fmt: skip
        _warn(found, silent, plain, self._doubts(records, found))
        return found

    def _doubts(self, records: Sequence[Record], found: FrequencyResponse) -> str:
        """What says that records disagree, where inputs are all that tells of outputs."""
        known = self.conditioned and not self.reference
        return differing(records, found.omega, found.G) if known else ""

    def _channels(self, records: Sequence[Record]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Inputs and outputs of the response: all channels but the references."""
        inputs, outputs = same_channels(records)
        if wrong := [name for name in self.reference if name not in (*inputs, *outputs)]:
            raise ValueError(
                f"reference: the records have no channel {wrong[0]!r}; they have "
                f"{', '.join((*inputs, *outputs))}"
            )
        if self.reference and not self.conditioned:
            raise ValueError("conditioned=False does not go with a reference; leave it out")
        left = (
            tuple(name for name in names if name not in self.reference)
            for names in (inputs, outputs)
        )
        inputs, outputs = left
        if not inputs or not outputs:
            raise ValueError(
                f"reference={tuple(self.reference)} leaves no input or no output; references are "
                "channels beside these"
            )
        return inputs, outputs

    def _ends(
        self, records: Sequence[Record], inputs: tuple[str, ...], outputs: tuple[str, ...]
    ) -> dict[str, float]:
        """Frequency [rad/s] above which what tells of an input is little but noise fed back."""
        if not self.reference:
            return sampling.excited_ends([record.select(inputs, outputs) for record in records])
        ends = sampling.excited_ends(self._referring(records, (), outputs))
        return dict.fromkeys(inputs, min(ends.values())) if ends else {}

    def _noise(self, records: Sequence[Record], omega: Array) -> NoiseInInputs:
        """The outputs' noise in inputs, or in the references that stand for these."""
        if self.reference:
            records = [record.select(inputs=self.reference) for record in records]
        return noise_in_inputs(records, omega, later=bool(self.reference))

    def _moving(
        self, records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[Record]:
        """The records with inputs that move, then the references, as inputs."""
        if not self.reference:
            return [record.select(inputs, outputs) for record in records]
        moving = set(self.reference) - {*still(records, self.reference)}
        if len(moving) != len(inputs) or len(self.reference) != len(inputs):
            raise ValueError(
                f"reference={tuple(self.reference)}, of which {len(moving)} move: expected one "
                f"moving reference for each input that moves ({', '.join(inputs)})"
            )
        return self._referring(records, inputs, outputs)

    def _referring(
        self, records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]
    ) -> list[Record]:
        """The records with some inputs, then the references, as inputs."""
        names = (*inputs, *self.reference)
        return [
            replace(
                record.select(outputs=outputs),
                u=np.column_stack([record.channel(name) for name in names]),
                inputs=names,
            )
            for record in records
        ]


def frequency_response(
    records: Records,
    *,
    omega: Array | None = None,
    windows: Sequence[float] | None = None,
    method: Method = "local",
    conditioned: bool = True,
    reference: Sequence[str] = (),
) -> FrequencyResponse:
    """Frequency response of all outputs to all inputs, with coherence and random error.

    Parameters
    ----------
    records : Record or sequence of Record
        Sweeps or other manoeuvres, best one axis at a time, several of each; trim removed or not.
        Non-equidistant records are interpolated (cubic spline) onto their median interval, lost
        samples are filled in (`casid.autoregression`), and windows that lack them for longer than
        a period are left out, with a `DataWarning`. Inputs held by steps ("zoh") are taken as
        steps, others as smooth.
    omega, windows, method, conditioned, reference
        As in `SpectralAnalysis`.

    Returns
    -------
    FrequencyResponse
        Points to distrust are listed in ``flags``; those that cannot be had at all are NaN, and a
        `DataWarning` says why. Another names a record whose own response is not the others'.

    Raises
    ------
    ValueError
        Frequencies beyond Nyquist's, windows longer than every record, too few windows without long
        losses.
    """
    analysis = SpectralAnalysis(
        omega=omega, windows=windows, method=method, conditioned=conditioned, reference=reference
    )
    return analysis.fit(records)


def _correlations(found: Estimate, active: Sequence[int], nu: int) -> dict[str, ComplexArray]:
    """Correlations of errors, of all inputs from those that move; empty if unknown."""
    if found.output_correlation is None or found.input_correlation is None:
        return {}
    full = np.tile(np.eye(nu, dtype=complex), (len(found.input_correlation), 1, 1))
    full[:, np.array(active)[:, None], active] = found.input_correlation
    return {"output_correlation": found.output_correlation, "input_correlation": full}


def _laid(values: Any, where: Any, shape: tuple[int, int]) -> Any:  # noqa: ANN401 - any numbers
    """Pairs of channels that move, (K, ny, nu); NaN for the others."""
    full = np.full((len(values), *shape), np.nan, dtype=values.dtype)
    full[:, *where] = values[:, where[0].ravel()]
    return full


def _parts(
    records: Sequence[Record], omega: Array, lengths: Sequence[float], analysis: SpectralAnalysis
) -> tuple[list[float], list[Conditioned], BoolArray]:
    """Window lengths with enough windows, their spectra, and where these are enough."""
    conditioned, references = analysis.conditioned, len(analysis.reference)
    whole = [filled(record) for record in records]
    pieces, gone = [r for r, _ in whole], [lost for _, lost in whole]
    kept, parts, counted = [], [], []
    for length in lengths:
        spectra = record_spectra(pieces, omega, length, gone, references)
        # With fewer windows than inputs nothing is left to tell the inputs apart; without those
        # in which an input moved, lost or in records shorter than a window, nothing but leakage
        # and the controller's answer is left of it.
        enough = spectra.count >= (records[0].nu - references if conditioned else 1)
        enough &= spectra.kept >= KEPT
        if enough.any():
            kept.append(length)
            part = condition(spectra, conditioned=conditioned)
            parts.append(replace(part, condition=np.where(enough, part.condition, 0.0)))
            counted.append(enough)
    if not parts:
        raise ValueError(_nothing_left(records, lengths[0]))
    share = max(float(lost.mean(axis=0).max()) for _, lost in whole)
    if share:
        warn(
            f"up to {100 * share:.2g} % of an output's samples are missing (NaN): filled in by a "
            "short autoregression, and windows left out where they are missing for longer than a "
            "period"
        )
    return kept, parts, np.array(counted)


def _nothing_left(records: Sequence[Record], length: float) -> str:
    gaps = [r.outputs[i] for r in records for i in np.flatnonzero(np.isnan(r.y).any(axis=0))]
    why = f"missing samples (NaN) in {gaps[0]!r} leave too few" if gaps else "there are too few"
    return (
        f"{why} windows of {length:g} s to separate {records[0].nu} inputs; use shorter windows, "
        "more records or Record.select"
    )


def _usable(
    omega: Array, lengths: Sequence[float], parts: Sequence[Conditioned], counted: BoolArray
) -> BoolArray:
    """Where each window counts and holds enough periods; the longest is used down to one."""
    periods = np.outer(lengths, omega) / (2 * np.pi)
    enough = periods >= sampling.FEW_PERIODS
    enough[-1] = periods[-1] >= 1
    # Leakage lends short windows a separation of the inputs that long ones show not to be there.
    finite = np.array([np.isfinite(part.Gxy).all(axis=(1, 2)) for part in parts])
    return np.asarray(enough & counted & np.all(finite | ~counted, axis=0), dtype=bool)


def _flags(
    omega: Array, longest: float, usable: BoolArray, counted: BoolArray, number: Array
) -> dict[str, tuple[int, ...]]:
    """Reasons to distrust points, and their positions."""
    periods = longest * omega / (2 * np.pi)
    some, known = usable.any(axis=0), counted.any(axis=0)
    together = "inputs move together: condition number above"
    unread, apart = (periods >= 1) & known & ~some, number <= MEANINGLESS
    why = {
        f"less than one period in the longest window ({longest:g} s)": periods < 1,
        f"less than {sampling.FEW_PERIODS:g} periods in the longest window ({longest:g} s)": (
            (periods >= 1) & (periods < sampling.FEW_PERIODS)
        ),
        "losses and short records leave too few windows to tell the inputs apart": ~known
        | (unread & apart),
        f"{together} {MEANINGLESS:g}, nothing separates them": unread & ~apart,
        f"{together} {SUSPECT:g}": some & (number > SUSPECT),
    }
    return _listed(why)


def _listed(why: Mapping[str, BoolArray]) -> dict[str, tuple[int, ...]]:
    """Positions where each reason holds, of those that hold somewhere."""
    return {word: tuple(int(k) for k in np.flatnonzero(at)) for word, at in why.items() if at.any()}


def _warn(
    found: FrequencyResponse, silent: Sequence[str], records: Sequence[Record], differ: str
) -> None:
    tell_repeats(records)
    if differ:
        warn(differ)
    for reason, at in found.flags.items():
        worst = np.nanmax(found.condition[list(at)]) if "condition" in reason else np.nan
        number = "" if np.isnan(worst) else f" (up to {worst:.3g})"
        lost = np.isnan(found.G[list(at)]).all() and "NaN" not in reason
        warn(
            f"{len(at)} of {len(found.omega)} frequencies, {found.omega[at[0]]:.3g} to "
            f"{found.omega[at[-1]]:.3g} rad/s: {reason}{number}"
            + ("; they are NaN" if lost else "")
            + ("; add records that move the inputs one at a time" if "inputs" in reason else "")
        )
    for name in silent:
        kind, part = ("input", "column") if name in found.inputs else ("output", "row")
        warn(f"{kind} {name!r} never moves: its {part} of the response is NaN")
