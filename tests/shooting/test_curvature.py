"""What Gauss-Newton leaves out, against differences of the cost."""

from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, flown, jittered, with_holes

from casid.free import free_parameters
from casid.shooting.curvature import costates, curvature
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator, Point, Sweep, whiteners

R = np.diag([0.1, 0.01, 0.02]) ** 2


def parts():
    """Records, their evaluator, where it is evaluated and with which multipliers of the ends."""
    records = [jittered(with_holes(flown(seed=1).between(0, 4))), flown(seed=2).between(0, 3)]
    free = free_parameters(TRUTH, fixed=("Lped",))
    evaluator, rng = Evaluator(free, lay_out(records, 1.5)), np.random.default_rng(3)
    J = len(evaluator.layout.count)
    nodes, bias = 0.1 * rng.standard_normal((J, 3)), rng.standard_normal((2, 3))
    return evaluator, Point(lam=free.guess, bias=bias, nodes=nodes), rng.standard_normal((J, 3))


def swept(evaluator, point):
    return Sweep(evaluator, point, evaluator.simulate(point), whiteners(R, evaluator.layout))


def squares(evaluator, point):
    """½ Σ r²/R of every channel."""
    return 0.5 * (evaluator.simulate(point).residuals ** 2 / np.diag(R)).sum(axis=0)


@pytest.mark.second
def test_gradients_are_differences_of_half_the_sum_of_squares():
    evaluator, point, mu = parts()
    found = curvature(swept(evaluator, point), mu)

    def slope(name, step):
        up, down = (
            squares(evaluator, replace(point, **{name: getattr(point, name) + s * step}))
            for s in (1, -1)
        )
        return (up - down) / 2

    for name, gradient, size in (("lam", found.gl, 1e-5), ("bias", found.gb, 1e-4),
                                 ("nodes", found.gn, 1e-4)):  # fmt: skip
        value = getattr(point, name)
        for at in np.ndindex(value.shape):
            step = np.zeros_like(value)
            step[at] = size * np.abs(value).mean()
            expected = slope(name, step) / step[at]
            # Quadratic in biases and nodes: rounding of costs of 1e5 over the step.
            np.testing.assert_allclose(gradient[:, *at], expected, rtol=1e-5, atol=1e-2)


def test_costates_run_back_through_every_interval():
    evaluator, _, mu = parts()
    layout, rng = evaluator.layout, np.random.default_rng(1)
    jumps, M = rng.standard_normal((len(layout.y), 3)), 0.5 * rng.standard_normal((3, 3))
    half = layout.classes[layout.step] / 2
    weight, later, earlier = (np.zeros_like(jumps) for _ in range(3))
    for start, count, end in zip(layout.start, layout.count, mu, strict=True):
        p = end
        for k in range(start + count - 1, start - 1, -1):
            later[k], earlier[k] = p, M @ p
            weight[k] += half[k] * earlier[k]
            p = earlier[k] + jumps[k]
            if k > start:
                weight[k] += half[k - 1] * p
    found = costates(layout, jumps, mu, lambda _, p: p @ M.T)
    last = layout.start + layout.count - 1
    for one, known in zip(found, (weight, half[last, None] * mu, later, earlier), strict=True):
        np.testing.assert_allclose(one, known, rtol=1e-12)


@pytest.mark.second
def test_curvature_is_what_gauss_newton_lacks_of_second_differences():
    evaluator, point, mu = parts()
    layout, nf = evaluator.layout, evaluator.nf

    def value(lam):
        at = replace(point, lam=lam)
        ends = evaluator.simulate(at).ends
        return squares(evaluator, at).sum() + (mu[layout.node] * ends).sum()

    sweep, lam = swept(evaluator, point), point.lam
    gauss = sum(batch.gram[:, :nf, :nf].sum(axis=0) for batch in sweep.batches())
    Hll, errors, sizes = curvature(sweep, mu).Hll, [], []
    for direction in np.random.default_rng(5).standard_normal((8, nf)):
        d = 1e-3 * np.abs(lam) * direction
        exact = value(lam + d) - 2 * value(lam) + value(lam - d)
        missing = exact - d @ gauss @ d
        errors.append(d @ Hll @ d - missing)
        sizes.append(missing)
    # The trapezoidal rule errs by (|A| h)²/12; matrices are affine in these parameters.
    assert np.abs(errors).max() < 0.01 * np.abs(sizes).max()
