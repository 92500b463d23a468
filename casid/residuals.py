"""What a model leaves of records: whether it is white, and the traces of inputs in it.

As in L. Ljung, System Identification: Theory for the User, 2nd ed., section 16.6.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from casid.arrays import Array, BoolArray
from casid.display import Shown, listed
from casid.goodness_of_fit import BAND
from casid.prediction import PredictionPlan
from casid.records import Records, same_channels, same_interval, standard_deviations, stretches
from casid.samples import known_mean
from casid.threads import one_thread
from casid.unexplained_variance import unexplained
from casid.validation import AnyModel, Validation, predicted, validate

LAGS = 25  # usual in the field
EXACT = 1e-6  # of its size: noise of an output below which it has none
WIDE = 0.5  # correlation: where the band is wider, hardly any can leave it


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Residuals(Shown):
    """Correlations of a model's residuals, pooled over records.

    Parameters
    ----------
    outputs, inputs : tuple of str
        Channels; of the outputs those that the model has and the records measured.
    lag : (2 L + 1,) array
        Lags [s], in step with the samples; a positive one: the input came before.
    auto : (2 L + 1, ny) array
        Autocorrelation of each residual, 1 at lag 0.
    cross : (2 L + 1, ny, nu) array
        Correlation of each residual with each input that many seconds before.
    auto_band : float
        99 % of a white residual's autocorrelations are within ±this.
    cross_band : (ny, nu) array
        The same of a residual that has nothing to do with the input, each as coloured as it is.
    rms : (ny,) array
        Root mean square of the residuals, in the units of the outputs.
    records : tuple of str
        Names of the records.
    unexplained : tuple of str
        Outputs whose residuals are as large as they move and no white noise, in words.
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    lag: Array
    auto: Array
    cross: Array
    auto_band: float
    cross_band: Array
    rms: Array
    records: tuple[str, ...]
    unexplained: tuple[str, ...] = ()

    def headline(self) -> str:
        """Records, and the outputs whose residuals the inputs explain still, or may do."""
        left = self.inside()[:, 1:] < 0.9
        wide = (self.cross_band > WIDE) & ~left
        said = [f"records {listed(self.records)}"]
        if left.any():
            said.append(f"traces left in {self._pairs(left)}")
        elif not wide.all():
            said.append("no trace of an input")
        if wide.any():
            said.append(f"in {self._pairs(wide)} none can be told: the band is too wide")
        if self.unexplained:
            said.append(f"nothing explained of {listed(self.unexplained, 4)}")
        return "; ".join(said)

    def _pairs(self, which: BoolArray) -> str:
        """Outputs and inputs (ny, nu) in words."""
        pairs = zip(*np.nonzero(which), strict=True)
        return listed([f"{self.outputs[i]} of {self.inputs[j]}" for i, j in pairs], 8)

    def inside(self) -> Array:
        """Share of the correlations inside their band, (ny, 1 + nu): auto (lags above 0), cross."""
        after = self.lag > 0
        white = np.mean(np.abs(self.auto[after]) <= self.auto_band, axis=0)
        apart = np.mean(np.abs(self.cross[~(self.lag < 0)]) <= self.cross_band, axis=0)
        return np.column_stack([white, apart])


@one_thread
def residuals(model: AnyModel, records: Records, *, lags: int = LAGS) -> Residuals:
    """Correlations of a model's residuals with themselves and with the inputs.

    Parameters
    ----------
    model : Fit, Model, BlackBox or StateSpace
        Simulated over each record from a fitted initial state, with fitted biases, outputs weighed
        by what is left of them; predicted piece by piece where it grows too much, as by `validate`.
    records : Record or sequence of Record
        Equidistant; missing samples are passed over.
    lags : int
        Samples to correlate over, at least 1.

    Raises
    ------
    ValueError
        Records sampled at different or changing intervals, fewer samples than lags, and what
        `validate` raises.
    """
    records = stretches(records)
    same_channels(records)
    first = records[0]
    for record in records:
        if not record.equidistant or not same_interval(record, first):
            raise ValueError(
                f"record {record.name!r} is not sampled every {first.dt:g} s: resample all records "
                "alike (Record.resample)"
            )
        if not 1 <= lags < record.N // 2:
            raise ValueError(f"lags={lags}: expected 1 to {record.N // 2 - 1} of {record.name!r}")
    found = validate({"model": model}, records)
    errors = _errors(model, found)
    seen = np.flatnonzero(np.isfinite(np.vstack(errors)).any(axis=0))
    errors = [e[:, seen] for e in errors]
    left = [_centred(e) for e in errors]
    moved = [_centred(record.u) for record in records]
    power = _root(left), _root(moved)
    auto = np.stack([_pooled(left, left, i, i, lags) for i in range(len(seen))], axis=-1)
    auto = auto / np.maximum(power[0] ** 2, 1e-300)
    cross = np.array(
        [[_pooled(left, moved, i, j, lags) for j in range(first.nu)] for i in range(len(seen))]
    ).transpose(2, 0, 1) / np.maximum(np.outer(*power), 1e-300)
    N = sum(record.N for record in records)
    outputs = tuple(first.outputs[i] for i in seen)
    mean_square = np.nanmean(np.vstack(errors) ** 2, axis=0)
    return Residuals(
        outputs=outputs,
        inputs=first.inputs,
        lag=first.dt * np.arange(-lags, lags + 1),
        auto=auto,
        cross=cross,
        auto_band=BAND / float(np.sqrt(N)),
        cross_band=BAND * np.sqrt(np.array(list(_spread(left, moved, power))) / N),
        rms=np.sqrt(mean_square),
        records=tuple(record.name for record in records),
        unexplained=tuple(unexplained(outputs, [r.y[:, seen] for r in records], mean_square)),
    )


def _errors(model: AnyModel, found: Validation) -> list[Array]:
    """What a model leaves of each record (N, ny), its unknowns of greatest likelihood.

    By the outputs' sizes, as `validate` weighs them to compare models, an output of much noise
    would move unknowns so far that those of little noise have residuals of their shape.
    """
    records = found.measured
    left: list[Array] = [r.y - y for r, y in zip(records, found.simulated["model"], strict=True)]
    size = standard_deviations(records)[1]
    noise = np.sqrt(known_mean(np.vstack(left) ** 2))
    scale = np.maximum(noise, EXACT * size)
    biased = [name for name in found.outputs if name not in found.unbiased]
    for i, record in enumerate(records):
        if np.isinf(found.horizon[i]) and len(found.known["model"]) > 1:  # one is weighed alone
            plan = PredictionPlan(np.inf)
            left[i] = record.y - predicted("model", model, record, plan, scale, biased).y
    return left


def _centred(x: Array) -> Array:
    """Without the mean; missing samples 0, which adds nothing to a correlation."""
    return np.where(np.isfinite(x), x - known_mean(x), 0.0)


def _root(records: list[Array]) -> Array:
    """Root of the sum of squares of each channel."""
    return np.asarray(np.sqrt(sum((x**2).sum(axis=0) for x in records)))


def _pooled(left: list[Array], right: list[Array], i: int, j: int, lags: int) -> Array:
    """Sum over records of Σ e_i(t) u_j(t - lag) at lags of -``lags`` to ``lags``."""
    total = np.zeros(2 * lags + 1)
    for e, u in zip(left, right, strict=True):
        full = scipy.signal.correlate(e[:, i], u[:, j], method="fft")
        total += full[len(u) - 1 - lags : len(u) + lags]
    return total


def _spread(left: list[Array], moved: list[Array], power: tuple[Array, Array]) -> Iterator[Array]:
    """Σ R_e(k) R_u(k), the variance of √N times a correlation of two that are independent."""
    reach = min(len(e) for e in left) // 2
    for i, e in enumerate(power[0]):
        own = _pooled(left, left, i, i, reach) / max(e**2, 1e-300)
        row = [
            own @ _pooled(moved, moved, j, j, reach) / max(u**2, 1e-300)
            for j, u in enumerate(power[1])
        ]
        yield np.maximum(row, 1.0)
