"""An estimate of a response with its errors: from windows, by local models, under feedback."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array, BoolArray, ComplexArray
from casid.errors import warn
from casid.frequency.composite import window_weights
from casid.frequency.feedback import MUCH, NoiseInInputs, bias_of_windows
from casid.frequency.leakage import leakage, over_three
from casid.frequency.local import local_response
from casid.frequency.response import FED_BACK, UNDRIVEN
from casid.frequency.spectra import Conditioned
from casid.record import Record

WEAK = 10.0  # F of references in an input, at least (Staiger and Stock): else up to a tenth is bias
SURE = 2.0  # of the noise of a difference that is no bias
HANN = 3.84  # rad: standard deviation of a Hann window's spectral window, times its length


@dataclass(frozen=True, eq=False, kw_only=True)
class Estimate:
    """A response with its errors, of pairs whose channels move."""

    G: ComplexArray
    coherence: Array
    random_error: Array
    leakage: Array
    feedback: Array
    resolution: Array
    output_correlation: ComplexArray | None
    input_correlation: ComplexArray | None
    driven: Array | None  # (K, nu) as of `Conditioned`

    @classmethod
    def of_windows(
        cls,
        merged: Conditioned,
        parts: Sequence[Conditioned],
        usable: BoolArray,
        lengths: Sequence[float],
        omega: Array,
        noise: NoiseInInputs,
    ) -> "Estimate":
        """The estimate from averaged spectra: response, errors and their correlations."""
        W = window_weights(parts, usable)
        return cls(
            G=merged.response,
            coherence=merged.coherence,
            random_error=merged.random_error,
            leakage=leakage(parts, usable, lengths, omega),
            feedback=bias_of_windows(noise, parts, W, merged.response),
            resolution=np.einsum("wkij,w->kij", W, HANN / np.array(lengths)),
            output_correlation=merged.output_correlation,
            input_correlation=merged.input_correlation,
            driven=merged.driven,
        )

    def refined(
        self,
        records: Sequence[Record],
        omega: Array,
        heard: Sequence[int],
        noise: NoiseInInputs,
        references: int = 0,
        end: float = np.inf,
    ) -> "Estimate":
        """What local models say of outputs that move, where these exist and inputs separate.

        Outputs that a record lacks, and all where losses leave no stretch, keep averaged spectra.
        Above ``end`` [rad/s] some input is little but noise fed back.
        """
        lacking = {
            i: record.name for record in records for i in heard if np.isnan(record.y[:, i]).all()
        }
        for i, name in lacking.items():
            output = records[0].outputs[i]
            warn(
                f"record {name!r} has no sample of {output!r}, so its response comes from "
                "averaged spectra, with larger errors than local models have: leave the record "
                "out, or estimate that output by itself"
            )
        heard = [i for i in heard if i not in lacking]
        if not heard:
            return self
        names = [records[0].outputs[i] for i in heard]
        parts = [record.select(outputs=names) for record in records]
        carried = None if references else noise.of(heard)
        local = local_response(parts, omega, carried, references, end)
        if local is None:
            warn(
                "losses leave no stretch for local models at some frequency, so the response "
                "comes from averaged spectra, with larger errors; leave the record with most "
                "losses out"
            )
            return self
        rows = np.isfinite(self.G[:, heard]) & np.isfinite(local.G) & (np.abs(local.G) > 0)
        found = {}
        told = ["G", "random_error", "leakage", "resolution"]
        for name in told if references else (*told, "feedback"):
            found[name] = np.array(getattr(self, name))
            found[name][:, heard] = np.where(rows, getattr(local, name), found[name][:, heard])
        every = rows.all(axis=(1, 2))
        inputs, outputs = (np.array(m) for m in (self.input_correlation, self.output_correlation))
        inputs[every] = local.input_correlation[every]
        block = np.ix_(np.flatnonzero(every), np.array(heard), np.array(heard))
        outputs[block] = local.output_correlation[every]
        return replace(self, **found, input_correlation=inputs, output_correlation=outputs)

    def compared(self, other: "Estimate") -> "Estimate":
        """The estimate with its leakage as another tells it, which has little.

        Window lengths may all be biased alike, so that they tell nothing of it; they do where noise
        hides how far the other is, and where the other is this one.
        """
        noise = 2 * (self.random_error**2 + other.random_error**2)
        with np.errstate(invalid="ignore", divide="ignore"):
            apart = np.abs(self.G - other.G) ** 2 / np.abs(self.G) ** 2
        beyond = over_three(np.fmax(np.nan_to_num(apart - SURE * noise, posinf=0.0), 0.0))
        hidden = np.fmin(self.leakage**2, noise) + other.leakage**2
        told = np.sqrt(beyond / (1 + beyond) + hidden)  # of both together, as local models have it
        known = np.isfinite(apart + told) & (self.G != other.G)
        return replace(self, leakage=np.where(known, told, self.leakage))

    def under_feedback(
        self, omega: Array, last: Sequence[float]
    ) -> tuple["Estimate", dict[str, BoolArray]]:
        """The estimate with the bias of feedback stated, and why what (K, ny, nu) is lost to it.

        ``last`` are the frequencies [rad/s] where inputs from outside end.
        """
        ended = omega[:, None, None] > np.array(last) * (1 + 1e-9)
        lost = {FED_BACK: (self.feedback > MUCH) | ended}
        if self.driven is not None:
            weak = np.isfinite(self.G) & ~(self.driven > WEAK)[:, None]
            lost = {UNDRIVEN: weak, FED_BACK: lost[FED_BACK] & ~weak}
        gone = np.any([*lost.values()], axis=0)
        G, coherence = (np.where(gone, np.nan, each) for each in (self.G, self.coherence))
        bias = np.hypot(self.leakage, self.feedback)
        return replace(self, G=G, coherence=coherence, leakage=bias), lost
