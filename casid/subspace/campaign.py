"""The records of a campaign as all estimates of a black box see them, gathered once."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from casid.arrays import Array, BoolArray
from casid.channels import FORCES
from casid.record import Record
from casid.records import Records, check_alive, same_channels, standard_deviations, stretches
from casid.slow_sources import tell_repeats
from casid.subspace import columns as blocks
from casid.subspace.fourier import Spectrum, spectra
from casid.subspace.laguerre import support
from casid.subspace.predictor import Stack, predicted_future, predictor_coefficients, triangular
from casid.subspace.realisation import Regressed, Subspace

EVERY = slice(None)
Columns = list[tuple[Stack, tuple[blocks.Segment, ...]]]  # of every record


@dataclass(frozen=True)
class Windows:
    """What a predictor is regressed with."""

    past: int  # number of Laguerre functions or samples
    future: int  # likewise
    pole: float  # Laguerre pole [rad/s], NaN for the samples themselves
    regularisation: float


@dataclass(frozen=True, eq=False)
class Campaign:
    """Records of the same channels, with what was gathered or estimated from them."""

    records: tuple[Record, ...]
    su: Array  # (nu,) standard deviations over all records
    sy: Array  # (ny,) likewise
    mask: BoolArray  # (ny, nu) where a direct term is free
    _gathered: dict[object, Columns] = field(default_factory=dict, repr=False)
    _regressed: dict[object, Regressed] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, records: Records, feedthrough: blocks.Feedthrough) -> "Campaign":
        """One record or several of the same channels."""
        names = same_channels(records)
        records = stretches(records)
        check_alive(records)
        blocks.check_independent(records)
        tell_repeats(records)
        su, sy = standard_deviations(records)
        return cls(records, su, sy, blocks.feedthrough_mask(feedthrough, *names))

    def part(self, records: Sequence[Record]) -> "Campaign":
        """Some of the records, or pieces of them, under the same scales."""
        return Campaign(tuple(records), self.su, self.sy, self.mask)

    @property
    def direct(self) -> set[str]:
        """Outputs that jump with the inputs: specific forces, and those singled out by the mask."""
        told = () if self.mask.all() else np.flatnonzero(self.mask.any(axis=1))
        return {*FORCES, *(self.records[0].outputs[i] for i in told)}

    @cached_property
    def complete(self) -> tuple[Record, ...]:
        """The records with missing samples filled in."""
        return tuple(blocks.completed(record) for record in self.records)

    def columns(self, past: int, a: float) -> Columns:
        """Stack and segments of every record, for a Laguerre pole or, where NaN, for samples."""
        key = past, str(a)
        if key not in self._gathered:
            if np.isnan(a):
                blocks.check_samples(self.records)
            else:
                blocks.check_pole(self.records, a)
            pairs = zip(self.records, self.complete, strict=True)
            self._gathered[key] = [
                blocks.gather([record], self.su, self.sy, past, a, [whole])
                for record, whole in pairs
            ]
        return self._gathered[key]

    def segments(self, past: int, a: float) -> tuple[blocks.Segment, ...]:
        """What was used of every record."""
        return tuple(segment for _, segments in self.columns(past, a) for segment in segments)

    def stack(self, past: int, a: float, without: Sequence[int] = ()) -> Stack:
        """Columns of all records but those with these numbers."""
        kept = [s for i, (s, _) in enumerate(self.columns(past, a)) if i not in without]
        R = triangular(np.vstack([each.R for each in kept]))
        return replace(kept[0], R=R, columns=sum(each.columns for each in kept))

    def subspace(self, order: int, windows: Windows, without: Sequence[int] = ()) -> Subspace:
        """Subspace estimate but for some records; ValueError if too short for windows or order."""
        w, key = windows, (str(windows), tuple(without))
        if key not in self._regressed:
            stack = self.stack(w.past, w.pole, without)
            self._check(stack, w.pole)
            projected = not np.isnan(w.pole)
            Xi, _ = predictor_coefficients(stack, self.mask, w.regularisation, at_one=projected)
            future, scales = predicted_future(stack, Xi, w.future), (self.su, self.sy)
            made = Regressed(stack, *scales, w.pole, self.mask, self.records[0].dt, future)
            self._regressed[key] = made
        found, first = self._regressed[key].model(order), self.records[0]
        system = replace(found.system, inputs=first.inputs, outputs=first.outputs)
        return replace(found, system=system)

    def pieces(self, a: float, which: slice = EVERY) -> list[Record]:
        """Stretches of the records without long gaps, short ones filled in."""
        pairs = zip(self.records[which], self.complete[which], strict=True)
        return [piece for record, whole in pairs for piece, _ in blocks.pieces_of(record, whole, a)]

    def spectra(self, a: float, highest: float, which: slice = EVERY) -> tuple[Spectrum, ...]:
        """Fourier transforms of the pieces up to ``highest`` [rad/s]."""
        return spectra(self.pieces(a, which), self.su, self.sy, highest)

    def band(self, a: float) -> tuple[float, float]:
        """Frequencies [rad/s] that the records excite and the projections show."""
        low, high = blocks.excited_band(self.records)
        return low, (high if np.isnan(a) else max(min(high, blocks.BAND_END * a), 2 * low))

    def _check(self, stack: Stack, a: float) -> None:
        """Raise where there are no more columns than unknowns."""
        unknowns = stack.past * stack.nz + stack.nu
        if stack.columns > unknowns:
            return
        longest = max(record.duration for record in self.records)
        samples = f"{stack.past + 1} samples"
        window = samples if np.isnan(a) else f"kernels of {support(a, stack.past):.2g} s"
        segments = self.segments(stack.past, a)
        shortest = min(segments, key=lambda segment: segment.used).record if segments else ""
        raise ValueError(
            f"record {shortest!r} is too short: {stack.columns} usable instants for {unknowns} "
            f"unknowns ({window}, longest record {longest:.3g} s); lower past, raise the pole or "
            "give longer records"
        )
