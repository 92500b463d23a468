"""Simulation by brute force: grids that hold the delays, SciPy's exponential, nothing of casid."""

import numpy as np
from scipy.linalg import expm

PARTS = 20  # of a sampling interval: the delays of the tests are whole numbers of them


def fine_inputs(u, delays, hold):
    """Delayed inputs at the ends of all parts of all steps, (N - 1, PARTS, 2, nu).

    u (N, nu) are the samples, ``delays`` (nu,) counted in sampling intervals. The values at a
    part's ends are limits from within it: inputs held in steps jump only between parts.
    """
    N, nu = u.shape
    fine = np.arange((N - 1) * PARTS)
    both = np.empty((len(fine), 2, nu))
    for j, delay in enumerate(delays):
        late = round(delay * PARTS)
        assert abs(late - delay * PARTS) < 1e-9
        first = fine - late  # the part that is heard now; before the record the inputs rest
        sample, part = np.divmod(first, PARTS)
        early = sample < 0
        sample = np.maximum(sample, 0)
        step = (u[sample + 1, j] - u[sample, j]) * (hold == "foh")
        for end in (0, 1):
            both[:, end, j] = np.where(early, u[0, j], u[sample, j] + step * (part + end) / PARTS)
    return both.reshape(N - 1, PARTS, 2, nu)


def simulate_finely(plant, h, u, delays, hold, x0=None):
    """Outputs (N, ny) of (A, B, C, D) sampled every h seconds, delays in sampling intervals."""
    A, B, C, D = (np.asarray(M, dtype=float) for M in plant)
    nx, nu = B.shape
    M = np.zeros((nx + 2 * nu, nx + 2 * nu))  # states, input, its rate
    M[:nx, :nx], M[:nx, nx : nx + nu], M[nx : nx + nu, nx + nu :] = A, B, np.eye(nu)
    E = expm(M * h / PARTS)[:nx]
    inputs = fine_inputs(u, delays, hold)
    x = np.zeros(nx) if x0 is None else np.array(x0, dtype=float)
    states = [x]
    for parts in inputs:
        for left, right in parts:
            x = E @ np.concatenate([x, left, (right - left) * PARTS / h])
        states.append(x)
    now = np.vstack([inputs[:, 0, 0], inputs[-1, -1, 1]])
    if hold == "zoh":  # a sample reads what its own step begins with
        k = np.maximum(len(u) - 1 - np.floor(np.asarray(delays) + 1e-9).astype(int), 0)
        now[-1] = u[k, np.arange(nu)]
    return np.array(states) @ C.T + now @ D.T
