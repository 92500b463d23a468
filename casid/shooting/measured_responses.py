"""Measured frequency responses in the likelihood of records.

    ½ Σ ‖W (Ĝ − G(jω; λ))‖²

with W of `casid.frequency.covariance`: every point by its stated error, noise and bias together,
though no surer than its neighbours, correlated with these in frequency and with other pairs. A
response that states no coherence has errors relative to the truth rather than to what was measured;
there Ĝ log(Ĝ/G) stands for the difference, lest points that came out small by chance count more.

What the structure misses of a response is no error of the measurement, and would rule all else.
Where residuals exceed their stated errors significantly, smoothed over frequency, pair by pair,
their points count less by as much, as lines of records do by their spectrum.
"""

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from casid.arrays import Array, ComplexArray
from casid.display import listed
from casid.errors import warn
from casid.evaluation import MatrixFunction
from casid.fingerprints import same_flight, same_prints
from casid.fit import AnyFit, Fit
from casid.free import Free
from casid.frequency.covariance import steadied, whitener
from casid.frequency.duplicates import same_numbers
from casid.frequency.response import FrequencyResponse
from casid.model import M, Model
from casid.record import Record
from casid.shooting.hausman import Source, disagreement, misstated

ROUNDS = 4  # of estimates, each weighed by the residuals of the last
FAR = 3.0  # stated errors that half of a pair's points are off, above which that is told
ALIKE = 0.2  # change of a weight's logarithm that makes no other estimate


WHY = (
    "in half of their points or more: a wrong unit or sign, another flight condition, or "
    "dynamics that the structure lacks. Their weight is reduced by as much"
)
APART = (
    "the estimate is a compromise, and all errors assume that both are right. Check units and "
    "gains of single channels, delays and clocks, flight condition, and what the structure "
    "misses, which the two may show differently; leave one of them out and compare"
)
LARGE = (
    "a response with errors stated too large hardly counts; errors are shares of the gain, 0.04 "
    "for 4 %: given in percent they are 100 times too large, in decibels 8.7 times"
)
SMALL = (
    "the stated errors are too small by that factor, or the structure misses as much. The weight "
    "of points is reduced where that is certain, but errors of parameters may be too small: "
    "state a larger random_error"
)


class MeasuredResponses:
    """Responses as evidence of a structure's free parameters.

    ValueError: none of the structure's pairs with a stated error in one of them.
    """

    def __init__(self, free: Free, responses: Sequence[FrequencyResponse]) -> None:
        self._matrices = MatrixFunction(free)
        self._names, self._index = free.names, free.index
        self._responses = [
            _Measured(
                free.model, each, f"response {k} (from {', '.join(each.records) or 'elsewhere'})"
            )
            for k, each in enumerate(responses, 1)
        ]
        self.weights: tuple[Array, ...] = tuple(np.ones(each.rows) for each in self._responses)
        self._last: tuple[bytes, list[tuple[Array, Array]]] = b"", []

    def weighed(self, weights: Sequence[Array]) -> "MeasuredResponses":
        """The same with weights of every response's rows."""
        other = copy.copy(self)
        other.weights, other._last = tuple(weights), (b"", [])
        return other

    def excess(self, values: Array) -> tuple[Array, ...]:
        """Weights (rows,) that make residuals at free values as large as stated on average."""
        plain = self.weighed([np.ones(each.rows) for each in self._responses])
        found = []
        for each, (r, _) in zip(self._responses, plain._parts(values), strict=True):
            found.append(each.excess(r))
        return tuple(found)

    def doubts(self, fit: AnyFit) -> Iterator[str]:
        """What speaks against responses at the estimate with these weights, in words."""
        far = [each.far(w) for each, w in zip(self._responses, self.weights, strict=True)]
        if any(far):
            pairs = listed([each for some in far for each in some])
            yield f"measured responses are farther off than their stated errors, {pairs}, {WHY}"
        values, P = fit.model.vector()[self._index], fit.notes.cramer_rao
        known = fit.notes.on_bounds(np.asarray(fit.covariance))
        for each, told, (r, J) in zip(self._responses, far, self._parts(values), strict=True):
            F = J.T @ J
            off = disagreement(Source(J.T @ r, F, _believed(r) * F), P, known)
            size = each.misstated(self._matrices, values, float(np.trace(P @ F)))
            if off.significant and not told:
                yield (
                    f"{each.name} contradicts the records and everything else that counts, "
                    f"{off.told(self._names)}: {APART}"
                )
            elif size != 1 and not told:
                yield (
                    f"{each.name} is off by {size:.2g} times its stated errors, which is not "
                    f"chance: {LARGE if size < 1 else SMALL}"
                )

    def residuals(self, values: Array) -> tuple[Array, Array]:
        """Independent residuals (m,) of unit variance at free values (nf,), and derivatives."""
        parts = self._parts(values)
        return np.concatenate([r for r, _ in parts]), np.vstack([J for _, J in parts])

    def scatter(self, values: Array) -> Array:
        """Covariance (nf, nf) of the cost's gradient.

        Where residuals are larger than stated they are believed, response by response.
        """
        return np.asarray(sum(_believed(r) * (J.T @ J) for r, J in self._parts(values)))

    def _parts(self, values: Array) -> list[tuple[Array, Array]]:
        key = values.tobytes()
        if self._last[0] != key:
            plain = (each.residuals(self._matrices, values) for each in self._responses)
            weighed = zip(self.weights, plain, strict=True)
            self._last = key, [(w * r, w[:, None] * J) for w, (r, J) in weighed]
        return self._last[1]


def _believed(r: Array) -> float:
    """Variance of residuals r that are no surer than stated."""
    return max(1.0, float(np.mean(r**2)))


def reweighed(
    estimate: Callable[[Free, bool], Fit[M, Any]], free: Free, near: AnyFit | None
) -> Fit[M, Any]:
    """The estimate with responses, weighed by the residuals of another, or as a fit nearby.

    ``estimate(free, rough)`` is asked for rough ones until their weights rest.
    """
    evidence, lam = free.evidence, free.guess
    if not isinstance(evidence, MeasuredResponses):
        return estimate(free, False)
    iterations, seconds, rounds = 0, 0.0, 0
    weights = getattr(near.notes, "response_weights", ()) if near is not None else ()
    settled = [len(w) for w in weights] == [len(w) for w in evidence.weights]
    if not settled:
        weights = evidence.excess(lam)
    while True:
        start = free.model.with_vector(free.full(lam))
        own = replace(free, model=start, evidence=evidence.weighed(weights))
        fit = estimate(own, not settled)
        iterations, seconds = iterations + fit.iterations, seconds + fit.seconds
        if settled:
            for said in evidence.weighed(weights).doubts(fit):
                warn(f"{fit.method}: {said}")
            notes = replace(fit.notes, response_weights=tuple(weights))
            return replace(fit, notes=notes, iterations=iterations, seconds=seconds)
        lam, rounds = fit.model.vector()[free.index], rounds + 1
        pairs = list(zip(weights, evidence.excess(lam), strict=True))
        settled = rounds == ROUNDS or all(np.abs(np.log(a / b)).max() < ALIKE for a, b in pairs)
        weights = [new for _, new in pairs]


class _Measured:
    """One response in the channels of a structure."""

    def __init__(self, model: Model, response: FrequencyResponse, name: str) -> None:
        self.name, self._estimated = name, bool(response.flights())
        rows = [k for k, name in enumerate(response.outputs) if name in model.outputs]
        columns = [k for k, name in enumerate(response.inputs) if name in model.inputs]
        own_rows = [model.outputs.index(response.outputs[k]) for k in rows]
        own_columns = [model.inputs.index(response.inputs[k]) for k in columns]
        every = range(len(response.omega))
        self._place, self._own = np.ix_(every, rows, columns), np.ix_(every, own_rows, own_columns)
        wanted = np.zeros(response.G.shape[1:], dtype=bool)
        wanted[np.ix_(rows, columns)] = True
        self._whiten, self._s = whitener(steadied(response), wanted), 1j * response.omega
        self._G = np.where(self._whiten.used, response.G, 1.0)
        self._names = response.outputs, response.inputs
        stated = np.nan_to_num(response.coherence, nan=1.0) < 1
        self._relative = self._whiten.used & ~stated

    def far(self, weights: Array) -> list[str]:
        """Pairs whose points, half of them or more, are far beyond their stated errors."""
        found, nu = [], len(self._names[1])
        for pair, _, own in self._whiten.runs():
            output, inp = self._names[0][pair // nu], self._names[1][pair % nu]
            factor = float(np.median(1 / weights[own]))
            found += [f"{output} after {inp} {factor:.2g} times"] * (factor > FAR)
        return found

    @property
    def rows(self) -> int:
        """Number of real residuals."""
        return 2 * sum(len(at) for _, at, _ in self._whiten.along)

    def excess(self, r: Array) -> Array:
        """Weights (rows,) of residuals r that are larger than stated, smoothed over frequency."""
        half = len(r) // 2
        return np.tile(1 / self._whiten.excess((r[:half] ** 2 + r[half:] ** 2) / 2), 2)

    def residuals(self, matrices: MatrixFunction, values: Array) -> tuple[Array, Array]:
        """Independent residuals (rows,) of unit variance, and derivatives (rows, nf)."""
        try:
            off, slopes = self._off(matrices, values)
        except np.linalg.LinAlgError:  # a pole on a frequency
            return np.full(self.rows, np.nan), np.full((self.rows, len(values)), np.nan)
        r, J = self._whiten(off), self._whiten(slopes)
        return np.concatenate([r.real, r.imag]), np.vstack([J.real, J.imag])

    def _off(self, matrices: MatrixFunction, values: Array) -> tuple[ComplexArray, ComplexArray]:
        """Measured less structure's response (K, ny, nu), and derivatives (K, ny, nu, nf)."""
        G, slopes = matrices(values).response_slopes(self._s)
        model, by_lam = self._G.copy(), np.zeros((*self._G.shape, len(values)), complex)
        model[self._place] = G[self._own]
        by_lam[self._place] = np.moveaxis(slopes, 0, -1)[self._own]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self._relative, self._G / model, 1.0)
        off = np.where(self._relative, self._G * np.log(ratio), self._G - model)
        return off, -by_lam * ratio[..., None]

    def misstated(self, matrices: MatrixFunction, values: Array, decided: float) -> float:
        """By what factor residuals are off their stated errors, deciding so many parameters."""
        off = np.abs(self._off(matrices, values)[0]) / self._whiten.std
        power = off[self._whiten.used] ** 2 / 2
        size = misstated(power, self._whiten.independent, decided)
        return max(size, 1.0) if self._estimated else size  # leakage is the most that it may be


def check_responses(
    model: Model, responses: Sequence[FrequencyResponse], records: Sequence[Record]
) -> None:
    """ValueError for a response of other channels, or of a record that counts already."""
    seen: list[tuple[str, tuple[str, ...]]] = []
    for response in responses:
        if not ({*response.outputs} & {*model.outputs} and {*response.inputs} & {*model.inputs}):
            raise ValueError(
                f"responses: no pair of {', '.join(response.outputs)} and "
                f"{', '.join(response.inputs)} is one of {type(model).__name__}'s"
            )
        own = []
        for name, prints, inputs, outputs in response.flights():
            for record in records:
                if same_flight(prints, inputs, outputs, record):
                    raise ValueError(
                        f"record {record.name!r} enters as a time history and, as {name!r}, in a "
                        "response: no datum counts twice; leave it out of one of them"
                    )
            if other := next((known for known, its in seen if same_prints(prints, its)), None):
                raise ValueError(
                    f"records {other!r} and {name!r} of two responses are one flight, which would "
                    "count twice; leave it out of one of them"
                )
            own.append((name, prints))
        seen += own
    same = (same_numbers(*two) for two in combinations(responses, 2))
    if said := next(filter(None, same), ""):
        raise ValueError(f"two responses {said}: no datum counts twice; leave one out")
