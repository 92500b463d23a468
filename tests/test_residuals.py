"""Residuals: correlations by hand, and the level of both tests over many records."""

from dataclasses import replace

import numpy as np
import pytest

from casid import Record, StateSpace, residuals, validate

DT, N = 0.05, 1200
ROLL = StateSpace([[-2.0]], [[4.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))


def flown(rng, *, colour=0.0, missed=0.0, noise=0.1, n=N):
    """A roll axis under a coloured stick; ``missed``: what the model does not know of the input."""
    t = DT * np.arange(n)
    u = np.zeros((n, 1))
    e = np.zeros(n)
    for k in range(1, n):
        u[k] = 0.9 * u[k - 1] + rng.standard_normal()
        e[k] = colour * e[k - 1] + rng.standard_normal()
    late = np.vstack([np.zeros((4, 1)), u[:-4]])
    y = ROLL.simulate(t, u) + noise * e[:, None] + missed * late
    return Record(t, u, y, ("lat",), ("p",), "stick")


def test_correlations_are_those_of_the_definition():
    record = flown(np.random.default_rng(0), n=200)
    found = residuals(ROLL, record, lags=7)
    assert found.rms[0] == pytest.approx(0.1, rel=0.15)
    # Without noise in state or bias the residual is what the simulation leaves: sums by hand.
    left = record.y[:, 0] - validate({"m": ROLL}, record).simulated["m"][0][:, 0]
    e, u = left - left.mean(), record.u[:, 0] - record.u.mean()
    for k, lag in ((7, 0), (10, 3), (14, 7)):
        assert found.lag[k] == pytest.approx(DT * lag)
        by_hand = sum(e[i] * e[i - lag] for i in range(lag, 200)) / (e @ e)
        assert found.auto[k, 0] == pytest.approx(by_hand, abs=1e-12)
        by_hand = sum(e[i] * u[i - lag] for i in range(lag, 200)) / np.sqrt((e @ e) * (u @ u))
        assert found.cross[k, 0, 0] == pytest.approx(by_hand, abs=1e-12)


def test_what_the_model_misses_is_traced_to_its_input_and_lag():
    found = residuals(ROLL, flown(np.random.default_rng(1), missed=0.3))
    peak = found.lag[np.argmax(np.abs(found.cross[:, 0, 0]))]
    assert peak == pytest.approx(4 * DT)
    assert "p of lat" in found.headline()


@pytest.mark.second
@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_of_a_true_model_99_percent_of_the_correlations_are_inside_their_bands(colour):
    # 25 records of 26 lags; neighbouring lags are correlated when the noise is, hence the room.
    rng = np.random.default_rng(2)
    shares = [residuals(ROLL, flown(rng, colour=colour)).inside()[0] for _ in range(25)]
    white, apart = np.mean(shares, axis=0)
    assert 0.96 < apart <= 1.0
    assert (0.97 < white < 1.0) if colour == 0 else (white < 0.5)


@pytest.mark.second
def test_a_quiet_output_beside_a_loud_one_has_white_residuals():
    # Turn and roll of a coupled pair, whose sizes are alike and whose noise is 1 to 50.
    pair = StateSpace(
        [[-0.1, 1.0], [-1.0, -0.1]],
        [[1.0], [0.0]],
        np.eye(2),
        np.zeros((2, 1)),
        None,
        ("lat",),
        "pr",
    )
    rng, t, inside, rms = np.random.default_rng(8), DT * np.arange(400), [], []
    noise = np.array([0.5, 0.01])
    for _ in range(30):
        u = rng.standard_normal((400, 1))
        y = pair.simulate(t, u) + noise * rng.standard_normal((400, 2))
        found = residuals(pair, Record(t, u, y, ("lat",), ("p", "r"), "stick"))
        inside.append(found.inside()[:, 0])
        rms.append(found.rms / noise)
    assert np.mean(inside, axis=0) == pytest.approx(0.99, abs=0.015)
    # Of 400 samples unknowns of greatest likelihood take four degrees of freedom at most.
    assert np.mean(np.square(rms), axis=0) == pytest.approx(1 - 2 / 400, abs=0.04)


def test_missing_samples_are_passed_over():
    record = flown(np.random.default_rng(3))
    y = record.y.copy()
    y[100:140] = np.nan
    broken = Record(record.t, record.u, y, record.inputs, record.outputs, "gap")
    whole, holed = residuals(ROLL, record), residuals(ROLL, broken)
    assert np.isfinite(holed.auto).all()
    np.testing.assert_allclose(holed.auto, whole.auto, atol=0.1)


def test_outputs_that_the_model_lacks_or_nobody_measured_are_not_judged():
    record = flown(np.random.default_rng(5))
    y = np.hstack([record.y, 2 * record.y, np.full((N, 1), np.nan)])
    more = Record(record.t, record.u, y, record.inputs, ("p", "q", "r"), "more")
    found, plain = residuals(ROLL, more), residuals(ROLL, record)
    assert found.outputs == ("p",)
    np.testing.assert_allclose(found.auto, plain.auto, atol=1e-9)
    np.testing.assert_allclose(found.inside(), plain.inside())


def test_records_of_two_rates_and_too_many_lags_are_refused():
    record = flown(np.random.default_rng(4), n=100)
    with pytest.raises(ValueError, match="resample all records alike"):
        residuals(ROLL, [record, record.take(slice(None, None, 2))])
    with pytest.raises(ValueError, match="lags=60: expected 1 to 49"):
        residuals(ROLL, record, lags=60)


def test_no_records_are_refused():
    lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(ValueError, match="no records given"):
        residuals(lag, [])


def swung(sign):
    """A roll axis under one slow sine, all of whose residual is a sine of that frequency, too."""
    t = DT * np.arange(N)
    u = np.sin(0.5 * t)[:, None]
    y = ROLL.simulate(t, u) + 0.01 * np.random.default_rng(6).standard_normal((N, 1))
    return Record(t, u, sign * y, ("lat",), ("p",), "sine")


def test_where_the_band_is_as_wide_as_a_correlation_can_be_no_trace_can_be_told():
    found = residuals(ROLL, swung(-1))
    # Autocorrelations of both are that sine; the sum of their products grows with N as N does.
    assert found.cross_band[0, 0] > 1
    assert np.abs(found.cross).max() > 0.9
    assert found.headline() == (
        "records sine; in p of lat none can be told: the band is too wide; "
        f"nothing explained of {found.unexplained[0]}"
    )
    assert found.unexplained[0].startswith("p (residuals of ")


def test_of_a_true_model_all_can_be_told_and_all_is_explained():
    found = residuals(ROLL, swung(1))
    assert found.cross_band[0, 0] < 0.2
    assert found.unexplained == ()
    assert found.headline() == "records sine; no trace of an input"


def test_what_can_be_told_and_what_cannot_stand_side_by_side():
    one, other = residuals(ROLL, swung(1)), residuals(ROLL, swung(-1))
    both = replace(
        one,
        outputs=("p", "q"),
        auto=np.hstack([one.auto, other.auto]),
        cross=np.hstack([one.cross, other.cross]),
        cross_band=np.vstack([one.cross_band, other.cross_band]),
    )
    assert both.headline() == (
        "records sine; no trace of an input; in q of lat none can be told: the band is too wide"
    )
    narrow = replace(both, cross_band=np.array([[0.6], [0.1]]))
    assert narrow.headline() == (
        "records sine; traces left in q of lat; in p of lat none can be told: the band is too wide"
    )
    beyond = replace(both, cross_band=np.array([[0.6], [0.6]]))  # that of q leaves it all the same
    assert beyond.headline() == narrow.headline()
