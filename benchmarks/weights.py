"""Weights that cover random ensembles: never violated, and how much too large.

python -m benchmarks.weights [RUNS]: Markdown for the documentation. An ensemble is a stable system
of two to five states, two inputs, three outputs, and twenty relatives, entries of A changed by
10 %; the last rows of a kind have lightly damped modes beside, one of a damping ratio between 0.001
and 0.1 or three of one damping ratio. Judged between the points of the certificate and at all
resonances, by responses computed here.
"""

import argparse

import numpy as np
import scipy.linalg

from casid import StateSpace, cover

BAND, ORDERS, SEED = (0.1, 30.0), (2, 4, 6), 4711
DAMPINGS = (0.05, 0.02, 0.01, 0.003, 0.001)


def ensemble(rng, light=False, damping=None):
    """A nominal system and its stable relatives; one light mode beside or three of a damping."""
    n = int(rng.integers(2, 6))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.2, 1)) * np.eye(n)
    for _ in range(3 if damping else int(light)):
        omega, zeta = rng.uniform(1, 15), damping or 10 ** rng.uniform(-3, -1)
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
    """Least weight over error, and its geometric mean, on a fine grid with all resonances."""
    poles = np.concatenate([each.poles() for each in (*systems, found.weight)])
    own = np.abs(poles.imag[:, None] + poles.real[:, None] * np.linspace(-3, 3, 25)).ravel()
    own = own[(own > BAND[0]) & (own < BAND[1])]
    omega = np.unique(np.concatenate([np.geomspace(*BAND, 4_000), own]))
    G0 = response(systems[0], omega)
    right = np.linalg.pinv(G0) if kind == "multiplicative" else np.eye(2)
    apart = [(response(each, omega) - G0) @ right for each in systems[1:]]
    error = np.max([np.linalg.norm(each, ord=2, axis=(1, 2)) for each in apart], axis=0)
    W = np.abs(response(found.weight, omega)[:, 0, 0] + found.weight.D[0, 0])
    over, x = W / np.maximum(error, 1e-6 * W), np.log(omega)
    return over.min(), np.exp(np.trapezoid(np.log(over), x) / (x[-1] - x[0]))


def row(kind, order, runs, light=False, damping=None):
    """Least of weight over error, mean and largest excess, and what would do where it is large."""
    rng = np.random.default_rng(SEED)
    judged, enough = [], []
    for _ in range(runs):
        systems = ensemble(rng, light, damping)
        if len(systems) < 2:
            continue
        found = cover(systems[0], systems[1:], band=BAND, order=order, kind=kind)
        judged.append(ratio(systems, found, kind))
        if found.excess > 1.5:
            enough.append(str(found.enough or "none"))
    low, excess = np.transpose(judged)
    cells = (len(low), int(np.sum(low < 1 - 1e-3)), f"{low.min():.5f}", f"{excess.mean():.3f}")
    beside = f"{kind}, three modes of ζ = {damping}" if damping else f"{kind}, light damping"
    do = f"{len(enough)}" + (f" ({', '.join(sorted(set(enough), key=len))})" if enough else "")
    return (beside if light or damping else kind, order, *cells, f"{excess.max():.2f}", do)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=100)
    runs = parser.parse_args().runs
    print("| kind | order | ensembles | violated | least | mean | worst | above 1.5 (would do) |")
    print("|---|---|---|---|---|---|---|---|")
    for kind in ("additive", "multiplicative"):
        rows = [(order, runs, False, None) for order in ORDERS]
        rows += [(6, runs // 5, True, None)]
        rows += [(10, max(runs // 25, 1), False, damping) for damping in DAMPINGS]
        for each in rows:
            print("|", " | ".join(map(str, row(kind, *each))), "|", flush=True)


if __name__ == "__main__":
    main()
