"""Vector autoregressions A(q) z = e of several channels, their order by Akaike's criterion.

It weighs errors one sample ahead, to which slow motion matters little: of four noisy loops it took
three lags, and spectra at their low edge were off by a tenth. So a memory of 0.3 s is kept, or as
much of it as samples allow for with little scatter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, ComplexArray

LAGS = 0.6  # time [s] that the autoregression reaches back at most
MOST = 60  # lags
TRIED = 1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1  # shares of that, tried by Akaike's criterion
ROWS = 4.0  # samples for every coefficient of an equation, at least
MEMORY, PLENTY = 0.5, 100.0  # share of the longest kept where there are so many samples for each


@dataclass(frozen=True, eq=False, kw_only=True)
class VectorAutoregression:
    """An autoregression of one flight, or of several that agree in it."""

    A: Array  # (p, n, n) coefficients
    S: Array  # (n, n) covariance of the innovations
    rows: int  # samples it comes from
    criterion: float  # Akaike's

    def polynomial(self, phase: Array) -> ComplexArray:
        """A(e^(jω dt)) at phases ω dt (K,), (K, n, n)."""
        lags = np.exp(-1j * np.outer(phase, np.arange(1, len(self.A) + 1)))
        return np.asarray(np.eye(self.A.shape[1]) - np.tensordot(lags, self.A, axes=1))


def of_flights(columns: Sequence[Array], dt: float) -> list[VectorAutoregression]:
    """The autoregression of all records' columns (N, n), or one of each if these differ."""
    longest, n = longest_lag(dt), columns[0].shape[1]
    least = max(1, round(TRIED[-1] * longest))
    enough = all(len(z) - longest >= ROWS * n * least for z in columns)
    if len(columns) == 1 or not enough:
        return [of_records(columns, dt)]
    total, single = np.zeros(2 * (n * (longest + 1),)), []
    for z in columns:  # whose products serve both
        G = lagged_products(z, longest)
        total += G
        single.append(_of_products(G, len(z) - longest, n, longest))
    rows = sum(each.rows for each in single)
    whole = _of_products(total, rows, n, longest)
    return single if sum(each.criterion for each in single) < whole.criterion else [whole]


def longest_lag(dt: float) -> int:
    """Most lags that are tried."""
    return max(2, min(MOST, round(LAGS / dt)))


def of_records(columns: Sequence[Array], dt: float) -> VectorAutoregression:
    """One autoregression of several records' columns (N, n)."""
    n, longest = columns[0].shape[1], longest_lag(dt)
    rows = sum(max(len(z) - longest, 0) for z in columns)
    products = (lagged_products(z, longest) for z in columns if len(z) > longest)
    return _of_products(sum(products, np.zeros(2 * (n * (longest + 1),))), rows, n, longest)


def _of_products(G: Array, rows: int, n: int, longest: int) -> VectorAutoregression:
    """That of `lagged_products` G, sums over so many rows, its lags chosen."""
    lags = sorted({max(1, round(share * longest)) for share in TRIED})
    lags = [p for p in lags if rows >= ROWS * n * p]
    if not lags:
        raise ValueError(
            f"{rows} samples are too few to tell feedback from excitation of {n} channels; "
            "give longer records, or fewer channels"
        )
    kept = max([p for p in lags if p <= min(MEMORY * longest, rows / (PLENTY * n))], default=0)
    tried = [_of_lags(G, rows, n, p) for p in lags if p >= kept]
    return min(tried, key=lambda each: each.criterion)


def _of_lags(G: Array, rows: int, n: int, p: int) -> VectorAutoregression:
    """The autoregression of p lags from the `lagged_products` G of n channels."""
    past = slice(n, n * (p + 1))
    inner = G[past, past] + 1e-10 * rows * np.eye(n * p)
    coefficients = np.linalg.solve(inner, G[past, :n])
    S = (G[:n, :n] - coefficients.T @ G[past, :n]) / rows
    S = (S + S.T) / 2 + 1e-12 * np.eye(n)
    return VectorAutoregression(
        A=coefficients.T.reshape(n, p, n).swapaxes(0, 1),
        S=S * rows / (rows - n * p),
        rows=rows,
        criterion=rows * np.linalg.slogdet(S)[1] + 2 * n * n * p + n * (n + 1),
    )


def lagged_products(z: Array, p: int) -> Array:
    """Σ over k of all products of z(k), z(k-1) ... z(k-p), (n (p + 1), n (p + 1))."""
    # Every block is its upper left neighbour and two products at the ends: no matrix of all lags.
    N, n = z.shape
    G = np.zeros((p + 1, p + 1, n, n))
    for j in range(p + 1):
        G[0, j] = z[p:].T @ z[p - j : N - j]
        G[j, 0] = G[0, j].T
    for i in range(p):
        into = z[p - 1 - i, :, None] * z[p - 1 :: -1][:p, None, :]
        out = z[N - 1 - i, :, None] * z[N - 1 : N - 1 - p : -1][:, None, :]
        G[i + 1, 1:] = G[i, :p] + into - out
    return np.asarray(G.transpose(0, 2, 1, 3).reshape(n * (p + 1), n * (p + 1)))
