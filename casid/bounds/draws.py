"""What makes other data of a campaign's: white noise, residuals shuffled, other initial states."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array
from casid.bounds.leverage import Leverage
from casid.linear import StateSpace
from casid.record import Record


@dataclass(frozen=True)
class NoiseDraw:
    """White noise of one seed on every record."""

    std: Mapping[str, float]
    seed: tuple[int, ...]

    def __call__(self, records: tuple[Any, ...]) -> tuple[Record, ...]:
        """Noisy records."""
        rng = np.random.default_rng(self.seed)
        return tuple(record.with_noise(self.std, rng) for record in records)


@dataclass(frozen=True, eq=False)
class KnownInitial:
    """Initial states of a linear structure of which means and standard deviations are known."""

    system: StateSpace
    away: tuple[Array, ...]  # (nx,) of every record: the means less where the records begin
    std: Array  # (nx,); zero, as is what is away, where nothing is known

    def moved(self, records: Sequence[Record], rng: np.random.Generator) -> tuple[Record, ...]:
        """The records as if they began in states drawn about the means."""
        found = []
        for record, away in zip(records, self.away, strict=True):
            x0 = away + self.std * rng.standard_normal(len(away))
            y = self.system.simulate(record.t, np.zeros_like(record.u), x0, record.hold)
            found.append(replace(record, y=record.y + y))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class BlockDraw:
    """Residuals put back on the simulation in blocks drawn from their own record, circularly.

    With the ``leverages`` of the fit each block regains what the fit has taken out of it: sooner
    than elsewhere, residuals are too small along the very sensitivities that estimates come from.
    """

    residuals: tuple[Array, ...]
    block: float
    seed: tuple[int, ...]
    initial: KnownInitial | None = None
    # of every record; large, and no other than residuals, records and fit say
    leverages: tuple[Leverage, ...] = field(default=(), compare=False)

    def __call__(self, records: tuple[Any, ...]) -> tuple[Record, ...]:
        """Records with shuffled residuals; samples are missing where they were."""
        rng = np.random.default_rng(self.seed)
        drawn = []
        for k, (record, residual) in enumerate(zip(records, self.residuals, strict=True)):
            length = min(max(round(self.block / record.dt), 1), record.N)
            first = rng.integers(record.N, size=-(-record.N // length))
            source = np.column_stack([_source(each, first, length) for each in residual.T])
            if self.leverages:
                noise = _restored(residual, source, length, self.leverages[k])
            else:
                noise = np.take_along_axis(residual, source, axis=0)
            drawn.append(replace(record, y=record.y + noise))
        return tuple(drawn) if self.initial is None else self.initial.moved(drawn, rng)


def _restored(residual: Array, source: NDArray[np.intp], length: int, leverage: Leverage) -> Array:
    """Residuals (N, ny) from these samples, with what the fit took out of each block."""
    white = leverage.whitened(residual)
    drawn = np.full_like(white, np.nan)
    for begin in range(0, len(source), length):
        block = source[begin : begin + length]
        rows, outputs = np.nonzero(np.isfinite(residual[begin : begin + length]))
        drawn[begin + rows, outputs] = leverage.restored(white, block[rows, outputs], outputs)
    return leverage.measured(drawn)


def _source(residual: Array, first: NDArray[np.intp], length: int) -> NDArray[np.intp]:
    """Which residuals (N,) of an output follow in blocks that begin with these, missing ones too.

    Its samples follow each other within a block whatever lies between them, so that as many are
    left of an output that is measured less often.
    """
    there = np.flatnonzero(np.isfinite(residual))
    begin, own = np.searchsorted(there, [first, length * np.arange(len(first))])
    number = (begin - own)[there // length] + np.arange(len(there))
    source = np.arange(len(residual))  # the missing stay where they are
    source[there] = there[number % max(len(there), 1)]
    return source
