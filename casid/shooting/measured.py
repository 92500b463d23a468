"""Measured frequency responses in the likelihood of records.

    ½ Σ ‖W (Ĝ − G(jω; λ))‖²

with W of `casid.frequency.covariance`: every point by its stated error, noise and bias together,
correlated with its neighbours in frequency and with other pairs. A response that states no
coherence has errors relative to the truth rather than to what was measured; there Ĝ log(Ĝ/G) stands
for the difference, lest points that came out small by chance count more.
"""

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.evaluation import MatrixFunction
from casid.fingerprints import same_flight
from casid.frequency.covariance import whitener
from casid.frequency.response import FrequencyResponse
from casid.model import Free, Model
from casid.record import Record


class MeasuredResponses:
    """Responses as evidence of a structure's free parameters.

    ValueError: none of the structure's pairs with a stated error in one of them.
    """

    def __init__(self, free: Free, responses: Sequence[FrequencyResponse]) -> None:
        self._matrices = MatrixFunction(free)
        self._responses = [_Measured(free.model, each) for each in responses]
        self._last: tuple[bytes, list[tuple[Array, Array]]] = b"", []

    def residuals(self, values: Array) -> tuple[Array, Array]:
        """Independent residuals (m,) of unit variance at free values (nf,), and derivatives."""
        parts = self._parts(values)
        return np.concatenate([r for r, _ in parts]), np.vstack([J for _, J in parts])

    def scatter(self, values: Array) -> Array:
        """Covariance (nf, nf) of the cost's gradient.

        Where residuals are larger than stated they are believed, response by response.
        """
        return np.asarray(
            sum(max(1.0, float(np.mean(r**2))) * (J.T @ J) for r, J in self._parts(values))
        )

    def _parts(self, values: Array) -> list[tuple[Array, Array]]:
        key = values.tobytes()
        if self._last[0] != key:
            self._last = key, [each.residuals(self._matrices, values) for each in self._responses]
        return self._last[1]


class _Measured:
    """One response in the channels of a structure."""

    def __init__(self, model: Model, response: FrequencyResponse) -> None:
        rows = [k for k, name in enumerate(response.outputs) if name in model.outputs]
        columns = [k for k, name in enumerate(response.inputs) if name in model.inputs]
        own_rows = [model.outputs.index(response.outputs[k]) for k in rows]
        own_columns = [model.inputs.index(response.inputs[k]) for k in columns]
        every = range(len(response.omega))
        self._place, self._own = np.ix_(every, rows, columns), np.ix_(every, own_rows, own_columns)
        wanted = np.zeros(response.G.shape[1:], dtype=bool)
        wanted[np.ix_(rows, columns)] = True
        self._whiten, self._s = whitener(response, wanted), 1j * response.omega
        self._G = np.where(self._whiten.used, response.G, 1.0)
        stated = np.nan_to_num(response.coherence, nan=1.0) < 1
        self._relative = self._whiten.used & ~stated

    def residuals(self, matrices: MatrixFunction, values: Array) -> tuple[Array, Array]:
        try:
            G, slopes = matrices(values).response_slopes(self._s)
        except np.linalg.LinAlgError:  # a pole on a frequency
            n = 2 * sum(len(at) for _, at, _ in self._whiten.along)
            return np.full(n, np.nan), np.full((n, len(values)), np.nan)
        model, by_lam = self._G.copy(), np.zeros((*self._G.shape, len(values)), complex)
        model[self._place] = G[self._own]
        by_lam[self._place] = np.moveaxis(slopes, 0, -1)[self._own]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(self._relative, self._G / model, 1.0)
        off = np.where(self._relative, self._G * np.log(ratio), self._G - model)
        r, J = self._whiten(off), self._whiten(-by_lam * ratio[..., None])
        return np.concatenate([r.real, r.imag]), np.vstack([J.real, J.imag])


def check_responses(
    model: Model, responses: Sequence[FrequencyResponse], records: Sequence[Record]
) -> None:
    """ValueError for a response of other channels, or of a record that counts already."""
    seen: dict[str, str] = {}
    for response in responses:
        if not ({*response.outputs} & {*model.outputs} and {*response.inputs} & {*model.inputs}):
            raise ValueError(
                f"responses: no pair of {', '.join(response.outputs)} and "
                f"{', '.join(response.inputs)} is one of {type(model).__name__}'s"
            )
        for name, prints in zip(response.records, response.fingerprints, strict=False):
            for record in records:
                if same_flight(prints, response.inputs, response.outputs, record):
                    raise ValueError(
                        f"record {record.name!r} enters as a time history and, as {name!r}, in a "
                        "response: no datum counts twice; leave it out of one of them"
                    )
            if other := next((seen[each] for each in prints if each in seen), None):
                raise ValueError(
                    f"records {other!r} and {name!r} of two responses are one flight, which would "
                    "count twice; leave it out of one of them"
                )
            seen |= dict.fromkeys(prints, name)
