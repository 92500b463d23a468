"""What follows the subspace estimate: which likelihood, and whether a controller spoils it."""

import contextlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casid.arrays import Array, BoolArray
from casid.errors import DataWarning
from casid.linear import StateSpace
from casid.record import Record
from casid.subspace.columns import pieces_of
from casid.subspace.feedback import fed_back_noise
from casid.subspace.fourier import spectra
from casid.subspace.gain import carried_gain, riccati_gain
from casid.subspace.held import refine_held
from casid.subspace.prediction import SampledUncertainty, refine_samples
from casid.subspace.refinement import ResponseUncertainty
from casid.subspace.refinement import refine as refine_black_box
from casid.subspace.regression import regress_inputs
from casid.subspace.settings import HIGHEST
from casid.subspace.simulation import refine_simulation
from casid.subspace.trust import explained_share

FED_BACK = 0.2  # bound on the relative bias from noise fed back, above which it is dealt with

Refine = bool | Literal["linear", "simulation"]
Noise = Literal["constant", "local"]
Uncertainty = ResponseUncertainty | SampledUncertainty | None
Estimate = tuple[StateSpace, Array, Uncertainty, Array | None]


@dataclass(frozen=True, eq=False)
class Refinement:
    """What follows the subspace estimate, by transform."""

    records: Sequence[Record]
    su: Array
    sy: Array
    mask: BoolArray
    pole: float
    band: tuple[float, float]
    R: Array  # residual covariance of the subspace estimate
    noise: Noise = "constant"

    def samples(self, starts: Sequence[tuple[StateSpace, Array]], refine: Refine) -> Estimate:
        """By prediction errors from the first start, or by simulation errors from all of them.

        Simulation starts from every start and from where prediction errors lead each.
        """
        system, K = starts[0]
        if not refine:
            return system, K, None, None
        if refine == "linear":
            return (
                *regress_inputs(system, K, self.records, self.su, self.sy, self.mask, self.R),
                None,
                None,
            )
        if refine != "simulation":
            return *self._predicting(system, K), None
        ends: list[tuple[StateSpace, Array]] = []
        for start in starts:
            with contextlib.suppress(ValueError):  # a predictor without modes still simulates
                ends.append(self._predicting(*start)[:2])
        self._check_feedback(*(ends or starts)[0])
        several = [each[0] for each in (*starts, *ends)]
        found = refine_simulation(
            several, self.records, self.su, self.sy, self.mask, local=self.noise == "local"
        )
        return found, np.zeros_like(K), None, None

    def _predicting(
        self, system: StateSpace, K: Array
    ) -> tuple[StateSpace, Array, SampledUncertainty]:
        return refine_samples(
            system, K, self.records, self.su, self.sy, self.mask, local=self.noise == "local"
        )

    def _check_feedback(self, system: StateSpace, K: Array) -> None:
        whole = [r for r in self.records if np.isfinite(r.y).all()]
        if whole and fed_back_noise(system, K, whole, self.su, self.sy) > FED_BACK:
            _warn_fed_back("refine=True, by prediction errors, removes that")

    def projections(self, system: StateSpace, K: Array, refine: bool) -> Estimate:
        """By Fourier transforms; by prediction errors where a controller would bias those."""
        pieces = [piece for r in self.records for piece, _ in pieces_of(r, self.pole)]
        if not refine:
            if fed_back_noise(system, K, pieces, self.su, self.sy) > FED_BACK:
                _warn_fed_back("refine=True removes that")
            return system, K, None, None
        data = spectra(pieces, self.su, self.sy, HIGHEST * self.pole)
        uncertainty: Uncertainty
        refined, uncertainty = refine_black_box(
            system, data, self.su, self.sy, self.mask, self.pole
        )
        K = carried_gain(system, K, refined, self.R)
        if fed_back_noise(refined, K, pieces, self.su, self.sy) > FED_BACK:
            try:
                refined, K, uncertainty = refine_held(
                    refined, K, pieces, self.su, self.sy, self.mask
                )
                K = riccati_gain(refined.A, refined.C, K, self.R)
            except ValueError as error:
                _warn_fed_back(f"prediction errors would remove that, but: {error}")
        return refined, K, uncertainty, explained_share(refined, data, self.su, self.sy, self.band)


def _warn_fed_back(remedy: str) -> None:
    warnings.warn(
        "the controller feeds so much of the outputs' noise back into the inputs that the black "
        f"box is biased; {remedy}; a smaller pole or less feedback helps too",
        DataWarning,
        stacklevel=4,
    )
