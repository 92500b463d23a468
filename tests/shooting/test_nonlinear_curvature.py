"""What Gauss-Newton leaves out for a nonlinear structure, against differences of the cost."""

from dataclasses import replace

import numpy as np
import pytest
from truths.swing import TRUTH, swung

from casid.free import free_parameters
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.nonlinear_curvature import hamiltonian
from casid.shooting.sensitivity import Point, whiteners

R = np.diag([0.05, 0.05]) ** 2


def parts():
    """An evaluator, where it is evaluated and the multipliers of the ends."""
    records = [swung(seed, noise=0.05, duration=4.0) for seed in (1, 2)]
    evaluator = NonlinearEvaluator(free_parameters(TRUTH), lay_out(records, 1.5), substeps=2)
    rng, J = np.random.default_rng(3), len(evaluator.layout.count)
    nodes, bias = 0.5 * rng.standard_normal((J, 2)), 0.1 * rng.standard_normal((2, 2))
    lam = TRUTH.vector() * [1.2, 0.9, 1.1, 1.0]
    return evaluator, Point(lam=lam, bias=bias, nodes=nodes), rng.standard_normal((J, 2))


def squares(evaluator, point):
    """½ Σ r²/R of every channel."""
    return 0.5 * (evaluator.simulate(point).residuals ** 2 / np.diag(R)).sum(axis=0)


def value(evaluator, point, mu):
    ends = evaluator.simulate(point).ends
    return squares(evaluator, point).sum() + (mu[evaluator.layout.node] * ends).sum()


def found_at(evaluator, point, mu):
    sweep = evaluator.sweep(point, evaluator.simulate(point), whiteners(R, evaluator.layout))
    batches = list(sweep.batches())
    return hamiltonian(sweep, mu), batches


@pytest.mark.parametrize("which", ["lam", "tau", "nodes", "both"])
def test_it_is_what_gauss_newton_lacks_of_second_differences(which):
    evaluator, point, mu = parts()
    found, batches = found_at(evaluator, point, mu)
    nf, layout, rng = evaluator.nf, evaluator.layout, np.random.default_rng(5)
    gram = np.concatenate([batch.gram for batch in batches])
    gram = gram[np.argsort(np.concatenate([layout.node[b.index] for b in batches]))]
    errors, sizes = [], []
    for _ in range(6):
        dl = 1e-3 * point.lam * rng.standard_normal(nf) * (which in {"lam", "tau", "both"})
        dl = dl * (np.arange(nf) == 3) if which == "tau" else dl
        dn = 1e-3 * rng.standard_normal(point.nodes.shape) * (which in {"nodes", "both"})
        up, down = (replace(point, lam=point.lam + s * dl, nodes=point.nodes + s * dn)
                    for s in (1, -1))  # fmt: skip
        exact = sum(value(evaluator, each, mu) for each in (up, down))
        exact -= 2 * value(evaluator, point, mu)
        d = np.hstack([np.tile(dl, (len(dn), 1)), dn])
        gauss = np.einsum("ja,jab,jb->", d, gram[:, : nf + 2, : nf + 2], d)
        second = dl @ found.Hll @ dl + 2 * np.einsum("a,jab,jb->", dl, found.Hln, dn)
        second += np.einsum("ja,jab,jb->", dn, found.Hnn, dn)
        errors.append(second - (exact - gauss))
        sizes.append(exact - gauss)
    # The trapezoidal rule at 25 samples a second, the last step of an interval by one value.
    assert np.abs(errors).max() < 0.05 * np.abs(sizes).max()


def test_gradients_are_those_of_each_channel():
    evaluator, point, mu = parts()
    found, rng = found_at(evaluator, point, mu)[0], np.random.default_rng(6)
    for _ in range(3):
        dl = 1e-4 * point.lam * rng.standard_normal(evaluator.nf)
        dn = 1e-4 * rng.standard_normal(point.nodes.shape)
        db = 1e-4 * rng.standard_normal(point.bias.shape)
        up, down = (
            Point(lam=point.lam + s * dl, bias=point.bias + s * db, nodes=point.nodes + s * dn)
            for s in (1, -1)
        )
        exact = (squares(evaluator, up) - squares(evaluator, down)) / 2
        slope = found.gl @ dl + np.einsum("cjs,js->c", found.gn, dn)
        slope += np.einsum("crb,rb->c", found.gb, db)
        np.testing.assert_allclose(slope, exact, rtol=1e-5)
