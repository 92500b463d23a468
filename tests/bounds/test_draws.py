"""Data made again: residuals in blocks, and initial states about what is known of them."""

from dataclasses import replace

import numpy as np
import pytest
from truths.decay import A, Decay, Plain
from truths.mixture import Inline, record

from casid import (
    DataWarning,
    Execution,
    OutputError,
    Record,
    bootstrap,
)
from casid.bounds import resampling
from casid.bounds.draws import BlockDraw

NOISE, SPREAD, T = 0.15, 0.1, 0.05 * np.arange(20)


def test_blocks_keep_the_order_of_their_residuals_and_begin_anywhere():
    r = record()
    flat = replace(r, y=np.zeros_like(r.y))
    number = np.arange(r.N, dtype=float)[:, None]
    (drawn,) = BlockDraw((number,), 0.5, (0, 1))((flat,))  # 20 Hz: blocks of 10
    blocks = drawn.y.reshape(-1, 10)
    np.testing.assert_array_equal(np.diff(blocks, axis=1) % r.N, 1)
    assert len(set(blocks[:, 0])) > 30  # of 40, drawn out of 400
    assert (np.diff(blocks[:, 0]) % r.N != 10).any()


def test_an_output_measured_less_often_keeps_its_samples_and_their_order():
    r = record()
    number = np.arange(r.N, dtype=float)[:, None]
    number[np.arange(r.N) % 4 > 0] = np.nan  # every fourth
    two = np.hstack([np.arange(r.N, dtype=float)[:, None], number])
    flat = replace(r, y=np.zeros((r.N, 2)), outputs=("y", "slow"))
    (drawn,) = BlockDraw((two,), 2.0, (0, 1))((flat,))  # blocks of 40, ten of the slow one
    np.testing.assert_array_equal(np.isfinite(drawn.y), np.isfinite(two))
    slow = drawn.y[::4, 1].reshape(-1, 10)
    np.testing.assert_array_equal(np.diff(slow, axis=1) % r.N, 4)
    apart = np.abs(drawn.y[::4, 0] - drawn.y[::4, 1])  # blocks of both outputs from one place
    assert (np.minimum(apart, r.N - apart) < 4).all()


def decays(seed):
    """Four short records."""
    rng = np.random.default_rng(seed)
    y = [rng.normal(1, SPREAD) * np.exp(A * T) + NOISE * rng.standard_normal(20) for _ in range(4)]
    u = [1e-3 * k * (np.arange(20) == 19) for k in range(4)]
    return [
        Record(T, u[k][:, None], y[k][:, None], ("u",), ("x",), f"{k}", hold="zoh")
        for k in range(4)
    ]


@pytest.mark.second
def test_what_is_drawn_begins_as_is_known(monkeypatch):
    by = OutputError(initial={"x": (1.0, SPREAD)}, biases=False)
    records = decays(0)
    fit = by.fit(Decay(), records)
    monkeypatch.setattr(resampling, "_ensemble", lambda _, draws, *more: draws)  # noqa: ARG005
    draws = bootstrap(fit, records, runs=400, block=0.1, estimator=by)
    begun = np.array(fit.initial_states)[:, 0]
    flat = [
        replace(record, y=x * np.exp(fit["a"].value * T)[:, None])
        for record, x in zip(records, begun, strict=True)
    ]
    silent = tuple(np.zeros((20, 1)) for _ in records)
    y = np.array([[r.y[:, 0] for r in replace(each, residuals=silent)(flat)] for each in draws])
    np.testing.assert_allclose(y, y[..., :1] * np.exp(fit["a"].value * T), rtol=1e-9)
    assert np.abs(y[..., 0].mean(axis=0) - 1).max() < 4 * SPREAD / np.sqrt(400)
    np.testing.assert_allclose(y[..., 0].std(axis=0), SPREAD, rtol=4 / np.sqrt(800))


@pytest.mark.campaign
def test_initial_states_are_drawn_about_what_is_known_of_them():
    # Of x₀ ~ N(1, s²) y is N(e, σ² I + s² e eᵀ) with e = exp(a t), whose slope by a is t e.
    e = np.exp(A * T)
    V = NOISE**2 * np.eye(20) + SPREAD**2 * np.outer(e, e)
    error = 1 / np.sqrt(4 * (T * e) @ np.linalg.solve(V, T * e))
    by = OutputError(initial={"x": (1.0, SPREAD)}, biases=False)
    scatter, means = [], []
    for seed in range(8):
        records = decays(seed)
        fit = by.fit(Decay(), records)
        found = bootstrap(
            fit, records, runs=12, block=0.1, estimator=by, execution=Execution(executor=Inline())
        )
        scatter.append(found.scatter[0])
        means.append(found.bias[0])
    assert np.sqrt(np.mean(np.square(scatter))) == pytest.approx(error, rel=4 / np.sqrt(2 * 8 * 11))
    assert abs(np.mean(means)) < 4 * error / np.sqrt(8 * 12)
    assert np.std(means) < 1.4 * error / np.sqrt(12)  # 0.53 errors, were they not drawn


def test_of_a_nonlinear_structure_it_is_said_that_they_are_not():
    by = OutputError(initial={"x": (1.0, SPREAD)}, biases=False)
    records = decays(0)
    with pytest.warns(DataWarning, match="known initial states .* are the same in all draws"):
        bootstrap(
            by.fit(Plain(), records), records, runs=2, block=0.1, estimator=by,
            execution=Execution(executor=Inline()),
        )  # fmt: skip
