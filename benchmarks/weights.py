"""Weights that cover random ensembles: never violated, and how much too large.

python benchmarks/weights.py [RUNS]: Markdown for the documentation. An ensemble is a stable system
of two to five states, two inputs, three outputs, and twenty relatives, entries of A changed by
10 %; the last rows have a lightly damped mode beside. Judged between the points of the certificate
and at all resonances, by responses computed here.
"""

import sys

import numpy as np
import scipy.linalg

from casid import StateSpace, cover

BAND, ORDERS, SEED = (0.1, 30.0), (2, 3, 4, 6, 8, 10), 4711


def ensemble(rng, light):
    """A nominal system and its stable relatives."""
    n = int(rng.integers(2, 6))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.2, 1)) * np.eye(n)
    if light:
        omega, zeta = rng.uniform(1, 15), 10 ** rng.uniform(-3, -1)
        A = scipy.linalg.block_diag(A, [[0, 1], [-(omega**2), -2 * zeta * omega]])
        n += 2
    B, C = rng.standard_normal((n, 2)), rng.standard_normal((3, n))
    changed = [A * (1 + 0.1 * rng.standard_normal(A.shape)) for _ in range(20)]
    kept = [each for each in changed if np.linalg.eigvals(each).real.max() < 0]
    return [StateSpace(each, B, C, np.zeros((3, 2))) for each in (A, *kept)]


def response(system, omega):
    """C (jω - A)⁻¹ B."""
    eye = np.eye(system.nx)
    x = np.linalg.solve(1j * omega[:, None, None] * eye - system.A, system.B)
    return system.C @ x


def ratio(systems, found, kind):
    """Weight over error on a fine grid and at all resonances."""
    poles = np.concatenate([each.poles() for each in (*systems, found.weight)])
    own = np.abs(poles.imag[:, None] + poles.real[:, None] * np.linspace(-3, 3, 25)).ravel()
    omega = np.concatenate([np.geomspace(*BAND, 4_000), own[(own > BAND[0]) & (own < BAND[1])]])
    G0 = response(systems[0], omega)
    right = np.linalg.pinv(G0) if kind == "multiplicative" else np.eye(2)
    apart = [(response(each, omega) - G0) @ right for each in systems[1:]]
    error = np.max([np.linalg.norm(each, ord=2, axis=(1, 2)) for each in apart], axis=0)
    W = np.abs(response(found.weight, omega)[:, 0, 0] + found.weight.D[0, 0])
    return float(np.min(W / np.maximum(error, 1e-6 * W)))


def row(kind, order, runs, light=False):
    """Least of weight over error, mean and largest excess."""
    rng = np.random.default_rng(SEED)
    least, excess = [], []
    for _ in range(runs):
        systems = ensemble(rng, light)
        if len(systems) < 2:
            continue
        found = cover(systems[0], systems[1:], band=BAND, order=order, kind=kind)
        least.append(ratio(systems, found, kind))
        excess.append(found.excess)
    low = np.array(least)
    cells = (len(low), int(np.sum(low < 1 - 1e-3)), f"{low.min():.5f}", f"{np.mean(excess):.3f}")
    name = f"{kind}, light damping" if light else kind
    return (name, order, *cells, f"{np.max(excess):.2f}")


def main(runs):
    """Print the table."""
    print("| kind | order | ensembles | violated | weight / error, least | excess, mean | worst |")
    print("|---|---|---|---|---|---|---|")
    for kind in ("additive", "multiplicative"):
        for order in ORDERS:
            print("|", " | ".join(map(str, row(kind, order, runs))), "|", flush=True)
        print("|", " | ".join(map(str, row(kind, 6, runs // 5, light=True))), "|", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
