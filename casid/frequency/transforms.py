"""Transforms of whole records without a taper, and of the stretches that losses leave of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array, BoolArray, ComplexArray
from casid.autoregression import filled
from casid.record import Record
from casid.samples import runs


@dataclass(frozen=True, eq=False)
class Lines:
    """Transforms of one record at its own frequencies ω_k = 2πk/T, k > 0."""

    omega: Array  # (L,) [rad/s]
    U: ComplexArray  # (L, nu)
    Y: ComplexArray  # (L, ny)


def lines_at(records: Sequence[Record], omega: Array, references: int) -> list[Sequence[Lines]]:
    """Lines to take at every frequency: of stretches without losses longer than a period."""
    full = [filled(record) for record in records]
    known: dict[tuple[bytes, ...], Sequence[Lines]] = {}
    found = []
    for period in 2 * np.pi / omega:
        cuts = [_gaps(lost, period / record.dt) for record, lost in full]
        key = tuple(gaps.tobytes() for gaps in cuts)
        if key not in known:
            parts = zip(full, cuts, strict=True)
            known[key] = [
                _lines(piece, references)
                for (record, _), gaps in parts
                for piece in _between(record, gaps)
            ]
        found.append(known[key])
    return found


def _gaps(lost: BoolArray, longest: float) -> NDArray[np.intp]:
    """Losses of a channel longer than so many samples, as `runs` has them."""
    gone = np.zeros(len(lost), dtype=bool)
    for column in lost.T:  # slower channels need not have a sample in common
        for start, end in runs(column):
            gone[start:end] |= end - start > longest
    return runs(gone)


def _between(record: Record, gaps: NDArray[np.intp]) -> list[Record]:
    """The stretches between gaps that have a line at least."""
    edges = [0, *gaps.ravel(), record.N]
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [record.take(slice(a, b)) for a, b in pairs if b - a > 2]


def _lines(record: Record, references: int) -> Lines:
    """Transforms of inputs and outputs; of references and, as outputs too, inputs."""
    values = np.hstack([record.u, record.y])
    X = np.fft.rfft(values - values.mean(axis=0), axis=0)[1:] * np.sqrt(record.dt / record.N)
    omega = 2 * np.pi * np.arange(1, len(X) + 1) / (record.N * record.dt)
    if record.hold == "zoh":  # the spectrum of the steps, not of a smooth input through the samples
        jh = 1j * omega * record.dt
        X[:, : record.nu] *= ((1 - np.exp(-jh)) / jh)[:, None]
    own = record.nu - references  # the inputs: before the outputs where they are outputs, too
    if references:
        return Lines(omega, X[:, own : record.nu], np.delete(X, slice(own, record.nu), axis=1))
    return Lines(omega, X[:, :own], X[:, own:])
