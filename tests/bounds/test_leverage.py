"""What a fit took out of its residuals, against the projection of linear least squares."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from truths.decay import Decay, Plain
from truths.mixture import NOISE, Mixture, least_squares, record

from casid import (
    Ensemble,
    OutputError,
    Record,
    bootstrap,
    output_error,
)
from casid.bounds import resampling
from casid.bounds.draws import BlockDraw
from casid.bounds.leverage import Leverage

N = 120  # samples of a short record: 6 s


def short():
    r = record()
    return replace(r, t=r.t[:N], u=r.u[:N], y=r.y[:N])


def drawn(monkeypatch, fit, flight, **settings):
    monkeypatch.setattr(resampling, "_ensemble", lambda _, draws, *more: draws)  # noqa: ARG005
    return bootstrap(fit, flight, runs=2, **settings)[0]


def columns():
    """Of least squares by a, b, d, initial states and bias: one space at any a and b."""
    return least_squares()[0][:N]


def test_it_is_the_projection_of_least_squares(monkeypatch):
    fit = output_error(Mixture(), [short()])
    (found,) = drawn(monkeypatch, fit, short()).leverages
    X = columns()
    B = found.taken[:, 0]
    np.testing.assert_allclose(B @ B.T, X @ np.linalg.pinv(X), atol=1e-9)
    np.testing.assert_allclose(found.whitener[:, 0, 0], 1 / np.sqrt(fit.R[0, 0]))


@pytest.mark.second
def test_held_parameters_take_nothing_and_known_ones_less(monkeypatch):
    X = columns()
    held = output_error(Mixture(a=1.0), [short()], fixed=["a"])
    (found,) = drawn(monkeypatch, held, short()).leverages
    Y = X[:, 1:]
    np.testing.assert_allclose(found.taken[:, 0] @ found.taken[:, 0].T, Y @ np.linalg.pinv(Y),
                               atol=1e-9)  # fmt: skip
    by = OutputError(priors={"a": (1.0, 0.01)}, biases=False)
    fit = by.fit(Mixture(), [short()])
    (found,) = drawn(monkeypatch, fit, short(), estimator=by).leverages
    Y = np.delete(X, 5, axis=1) * NOISE / np.sqrt(fit.R[0, 0])
    pull = np.diag([1 / 0.01**2, 0, 0, 0, 0])
    H = Y @ np.linalg.solve(Y.T @ Y + pull, Y.T)
    np.testing.assert_allclose(found.taken[:, 0] @ found.taken[:, 0].T, H, atol=1e-9)


def test_a_block_has_the_covariance_of_white_noise_again(monkeypatch):
    fit = output_error(Mixture(), [short()])
    (found,) = drawn(monkeypatch, fit, short()).leverages
    X, block = columns(), np.arange(50, 70)
    H = X @ np.linalg.pinv(X)
    left = (np.eye(N) - H)[np.ix_(block, block)]
    unit = np.zeros((N, 1))
    M = np.empty((20, 20))
    for k, sample in enumerate(block):
        unit[:] = 0
        unit[sample] = 1
        M[:, k] = found.restored(unit, block, np.zeros(20, dtype=int))
    np.testing.assert_allclose(M @ left @ M.T, np.eye(20), atol=1e-9)


@pytest.mark.slow
def test_estimates_of_draws_scatter_as_those_of_flights(monkeypatch):
    fit = output_error(Mixture(), [short()])
    draw = drawn(monkeypatch, fit, short())
    X = columns() * NOISE
    P, rng = np.linalg.pinv(X), np.random.default_rng(1)
    still = replace(short(), y=np.zeros((N, 1)))
    ratio = {True: [], False: []}
    for seed in range(60):
        noise = rng.standard_normal(N)
        left = (noise - X @ (P @ noise))[:, None]
        for whole, found in ratio.items():
            of = draw.leverages if whole else ()
            again = [BlockDraw((left,), 1.0, (seed, k), None, of) for k in range(15)]
            y = np.column_stack([each((still,))[0].y[:, 0] for each in again])
            found.append(np.var((P @ y)[:3], axis=1, ddof=1) / np.sum(P[:3] ** 2, axis=1))
    assert np.mean(ratio[False]) < 0.85
    assert np.mean(ratio[True]) == pytest.approx(1, abs=0.08)


def test_outputs_that_share_noise_are_whitened_by_all_that_is_there():
    R = np.array([[4.0, 1.0], [1.0, 9.0]])
    both, alone = np.linalg.inv(np.linalg.cholesky(R)), np.diag([0.0, 1 / 3])
    found = Leverage(np.zeros((2, 2, 0)), np.array([both, alone]))
    r = np.array([[1.0, 2.0], [np.nan, 3.0]])
    white = found.whitened(r)
    assert np.sum(white[0] ** 2) == pytest.approx(r[0] @ np.linalg.solve(R, r[0]))
    np.testing.assert_allclose(white[1], [np.nan, 1.0])
    np.testing.assert_allclose(found.measured(white), r)


@pytest.mark.second
@pytest.mark.parametrize(("n", "level"), [(50, 0.95), (39, 0.95), (12, 0.95), (19, 0.8)])
def test_an_interval_holds_one_more_draw_as_often_as_it_says(n, level):
    x = np.random.default_rng(0).standard_normal((n, 4000))
    found = Ensemble(
        names=tuple(map(str, range(4000))), reference=np.zeros(4000), values=x,
        std_errors=np.ones_like(x), reasons=("",) * n,
    )  # fmt: skip
    low, high = found.interval(level).T
    held = scipy.stats.norm.cdf(high) - scipy.stats.norm.cdf(low)
    assert held.mean() == pytest.approx(level, abs=0.005)


def test_an_interval_leaves_out_what_failed():
    x = np.array([[1.0], [2.0], [np.nan], [4.0]])
    found = Ensemble(
        names=("a",), reference=np.zeros(1), values=x, std_errors=x, reasons=("", "", "lost", "")
    )
    np.testing.assert_allclose(found.interval(0.5)[0], [1.0, 4.0])
    assert np.isnan(replace(found, reasons=("", "lost", "lost", "lost")).interval()).all()


def test_a_nonlinear_structure_takes_what_its_linear_one_does(monkeypatch):
    t = 0.05 * np.arange(20)
    noisy = np.exp(-0.5 * t) + 0.1 * np.random.default_rng(0).standard_normal(20)
    last = (t == t[-1])[:, None] * 1e-3
    records = [Record(t, last, noisy[:, None], ("u",), ("x",), hold="zoh")]
    by = OutputError(initial={"x": (1.0, 0.1)}, biases=False)
    found = []
    for structure in (Decay, Plain):
        fit = by.fit(structure(), records)
        monkeypatch.setattr(resampling, "warn", lambda _: None)
        of = drawn(monkeypatch, fit, records, block=0.1, estimator=by).leverages
        found.append([each.taken[:, 0] @ each.taken[:, 0].T for each in of])
    np.testing.assert_allclose(*found, atol=1e-5)
