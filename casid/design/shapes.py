"""Inputs of one axis as functions of few numbers, with their derivatives."""

from typing import Protocol

import numpy as np

from casid.arrays import Array

LEVEL = 0.7  # of the square wave that steps start from, as a share of the stick's limit


class Shape(Protocol):
    """An input of one axis; its numbers x (n,) begin at ``start`` and have bounds."""

    start: Array
    lower: Array
    upper: Array

    def signal(self, x: Array) -> Array:
        """The input (N,)."""

    def pulled_back(self, x: Array, slope: Array) -> Array:
        """Derivatives by x (n,) of a function with these derivatives (N,) by the input."""


class Steps:
    """A multi-step sequence: n levels, then n + 1 switching times, both free.

    Levels are shares of the stick's limit, times are moves from an even grid, in its spacings. The
    stick rests before the first switching and after the last. Edges are cubics, s² (3 - 2 s), of
    length ``edge`` [s], at samples t (N,): smooth in the switching times, which are no samples.
    """

    def __init__(
        self, t: Array, *, rest: float, step: float, edge: float, size: float,
        rng: np.random.Generator,
    ) -> None:  # fmt: skip
        self._N, self._h, self._edge, self._size = len(t), float(t[1] - t[0]), edge, size
        room = float(t[-1]) - rest - edge
        self.n = n = max(1, int(room / max(step, edge)))
        self._spacing = room / n
        self._grid = rest + self._spacing * np.arange(n + 1)
        levels = np.repeat(rng.choice([-LEVEL, LEVEL], n), rng.integers(1, 5, n))[:n]
        self.start = np.concatenate([levels, np.zeros(n + 1)])
        free = np.full(n, np.inf)
        self.lower = np.concatenate([-free, -np.arange(n + 1.0)])
        self.upper = np.concatenate([free, np.arange(n, -1.0, -1.0)])

    def times(self, x: Array) -> Array:
        """Instants (n + 1,) at which its edges begin [s]."""
        return np.asarray(self._grid + self._spacing * x[self.n :])

    def signal(self, x: Array) -> Array:
        """The input (N,)."""
        sample, rise, _ = self._edges(x)
        moves = np.zeros(self._N)
        np.add.at(moves, sample, rise * self._jumps(x)[:, None])
        return np.asarray(self._size * np.cumsum(moves))

    def pulled_back(self, x: Array, slope: Array) -> Array:
        """Derivatives by x (2 n + 1,) of a function with these derivatives (N,) by the input."""
        sample, rise, speed = self._edges(x)
        rest = np.cumsum(slope[::-1])[::-1]
        by_jump = (rise * rest[sample]).sum(axis=1)
        by_time = -self._spacing * self._jumps(x) * (speed * slope[sample]).sum(axis=1)
        return np.asarray(self._size * np.concatenate([by_jump[:-1] - by_jump[1:], by_time]))

    def _edges(self, x: Array) -> tuple[np.ndarray, Array, Array]:
        """Samples of each edge (n + 1, W), what it rises by there, and its slope [1/s]."""
        times = self.times(x)[:, None]
        count = int(np.ceil(self._edge / self._h)) + 1
        sample = np.floor(times / self._h).astype(int) + np.arange(count + 1)
        sample = np.minimum(sample, self._N - 1)
        s = np.clip((self._h * sample - times) / self._edge, 0.0, 1.0)
        rise = np.diff(s * s * (3.0 - 2.0 * s), axis=1)
        return sample[:, 1:], rise, (6.0 * s * (1.0 - s) / self._edge)[:, 1:]

    def _jumps(self, x: Array) -> Array:
        return np.diff(x[: self.n], prepend=0.0, append=0.0)


class Waves:
    """A multisine: coefficients of cosines, then of sines, as shares of the stick's limit.

    They begin where the waves (N, 2 K), as large as they are to be, have the phases (K,).
    """

    def __init__(self, waves: Array, phases: Array, size: float) -> None:
        amplitude = np.abs(waves).max(axis=0) / size
        self._family = waves / np.maximum(amplitude, 1e-300)
        self.start = amplitude * np.append(np.cos(phases), -np.sin(phases))
        self.upper = np.full(len(self.start), np.inf)
        self.lower = -self.upper

    def signal(self, x: Array) -> Array:
        """The input (N,)."""
        return np.asarray(self._family @ x)

    def pulled_back(self, x: Array, slope: Array) -> Array:  # noqa: ARG002 - as every shape's
        """Derivatives by x (2 K,) of a function with these derivatives (N,) by the input."""
        return np.asarray(self._family.T @ slope)
