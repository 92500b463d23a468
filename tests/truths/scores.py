"""Scatter of scores, of one kind alone."""

import numpy as np

from casid.shooting.scores import BlockScores, ProcessScores, summed


def process_scores(k, C, slopes):
    """Of a process with the covariances C, for slopes of every record in pieces."""
    found = ProcessScores(C, k)
    summed([np.zeros(0)] * len(slopes), slopes, [found])
    return found.total()


def block_scores(k, residuals, slopes, length):
    """By blocks, and of whole records."""
    found = BlockScores(length, k)
    summed(residuals, slopes, [found])
    return found.K, found.records()


def autoregressive(n, A, rng):
    """n samples of z(t) = A z(t - 1) + white noise of variance one."""
    z = np.zeros((n + 100, len(A)))
    for t in range(1, len(z)):
        z[t] = A @ z[t - 1] + rng.standard_normal(len(A))
    return z[100:]
