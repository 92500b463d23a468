"""Scatter of scores against double sums and least squares with blocks left out."""

import numpy as np
from truths.scores import autoregressive, block_scores, process_scores

from casid.shooting.scores import BlockScores, ProcessScores, summed
from casid.shooting.uncertainty import residual_covariance

RNG = np.random.default_rng(8)


def test_scores_of_a_process_are_the_double_sum():
    ny, nf, A = 2, 3, np.array([[0.7, 0.3], [-0.2, 0.5]])
    residuals = [autoregressive(n, A, RNG) for n in (310, 200)]
    slopes = [RNG.standard_normal((len(r), ny, nf)) for r in residuals]
    root = RNG.standard_normal((nf, 2))
    C = residual_covariance(residuals)
    lags = len(C) - 1
    assert lags > 3
    middle = np.zeros((nf, nf))
    for s in slopes:
        for i in range(len(s)):
            for j in range(max(0, i - lags), min(len(s), i + lags + 1)):
                middle += s[i].T @ (C[j - i] if j >= i else C[i - j].T) @ s[j]
    expected = root.T @ middle @ root
    for pieces in (1, 3, 8):  # the last: shorter than the longest lag
        parts = [np.array_split(s @ root, pieces) for s in slopes]
        found = process_scores(2, C, parts)
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_scores_of_blocks_are_what_leaving_them_out_does_to_least_squares():
    X, length = [RNG.standard_normal((n, 2, 3)) for n in (50, 33)], 5  # the last part is shorter
    y = [RNG.standard_normal(x.shape[:2]) for x in X]
    sample = np.concatenate([np.stack([np.full(len(x), k), np.arange(len(x))], 1)
                             for k, x in enumerate(X)])  # fmt: skip
    flat, values = np.concatenate(X), np.concatenate(y)

    def solved(rows):
        return np.linalg.lstsq(flat[rows].reshape(-1, 3), values[rows].ravel())[0]

    whole, expected = solved(np.full(len(flat), True)), np.zeros((3, 3))
    for k, x in enumerate(X):
        for first in range(-15, len(x), 5):  # four parts of five samples
            inside = (sample[:, 1] >= first) & (sample[:, 1] < first + 20)
            change = whole - solved(~(inside & (sample[:, 0] == k)))
            expected += np.outer(change, change) / 4
    root = np.linalg.cholesky(np.linalg.inv(np.einsum("nai,naj->ij", flat, flat)))
    residuals = [b - a @ whole for a, b in zip(X, y, strict=True)]
    for pieces in (1, 4):
        parts = [np.array_split(x @ root, pieces) for x in X]
        K, _ = block_scores(3, residuals, parts, length)
        found = root @ K @ root.T
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_what_is_summed_together_is_what_is_summed_alone_and_slopes_come_once():
    residuals = [autoregressive(n, np.array([[0.6]]), RNG) for n in (90, 60)]
    slopes, taken = [RNG.standard_normal((len(r), 1, 2)) for r in residuals], []

    def pieces():
        for s in slopes:
            yield (taken.append(len(each)) or each for each in np.array_split(s, 3))

    C = residual_covariance(residuals)
    process, blocks = ProcessScores(C, 2), BlockScores(7, 2)
    summed(residuals, pieces(), [process, blocks])
    assert taken == [30, 30, 30, 20, 20, 20]
    parts = [[s] for s in slopes]
    np.testing.assert_allclose(process.total(), process_scores(2, C, parts), rtol=1e-12)
    K, records = block_scores(2, residuals, parts, 7)
    np.testing.assert_allclose(blocks.K, K, rtol=1e-12)
    for found, alone in zip(blocks.records(), records, strict=True):
        np.testing.assert_allclose(found, alone, rtol=1e-12)
