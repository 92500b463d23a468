"""Predictions of unstable models: from the past alone, over a stated horizon."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from casid import Record, StateSpace, validate
from casid.prediction import (
    AHEAD,
    FOLDS,
    INSTANTS,
    RecordPredictor,
    growth_rate,
    predict,
    prediction_plan,
)
from casid.validation import measures

DT = 0.02
T = DT * np.arange(1500)
STABLE = StateSpace([[-1.0, 2.0], [-2.0, -1.0]], [[0.0], [1.0]], np.eye(2), np.zeros((2, 1)),
                    inputs=("u",), outputs=("a", "b"))  # fmt: skip


def with_spurious(rate, size=0.02):
    """The stable system with a growing pair that the data do not have."""
    A = np.block([[STABLE.A, np.zeros((2, 2))],
                  [np.zeros((2, 2)), np.array([[rate, 5.7], [-5.7, rate]])]])  # fmt: skip
    B = np.vstack([STABLE.B, [[size], [size]]])
    C = np.hstack([STABLE.C, np.eye(2)])
    return StateSpace(A, B, C, np.zeros((2, 1)), inputs=("u",), outputs=("a", "b"))


def steps():
    return np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 30), 50)[:, None]


def flown(system=STABLE, noise=0.02):
    y = system.simulate(T, steps()) + noise * np.random.default_rng(3).standard_normal((len(T), 2))
    return Record(T, steps(), y, ("u",), ("a", "b"), "steps")


@pytest.mark.second
def test_a_prediction_knows_nothing_of_what_was_measured_after_its_start():
    record = flown()
    (horizon,) = validate({"m": with_spurious(1.0)}, [record]).horizon
    piece = int(horizon / DT + 1e-9)
    cut = 900
    y = record.y.copy()
    y[cut:] = 2 * y[cut] - y[cut:]  # of its second differences, the size of noise, one changes
    before, after = (
        validate({"m": with_spurious(1.0)}, [each]).simulated["m"][0]
        for each in (record, replace(record, y=y))
    )
    np.testing.assert_allclose(after[:cut], before[:cut], atol=1e-3)
    assert np.abs(after - before)[cut + 2 * piece :].max() > 0.1


def test_a_growing_pair_that_is_not_there_is_not_excused():
    record = flown()
    result = validate({"sound": STABLE, "spurious": with_spurious(4.2)}, [record])
    assert result.growth == {"sound": 0.0, "spurious": pytest.approx(4.2)}
    assert result.horizon[0] == pytest.approx(FOLDS / 4.2)
    sound, spurious = (result.rms[name][0] for name in ("sound", "spurious"))
    # Noise of 0.02 alone for the sound one; the other's grows e^3 = 20 times from what is left of
    # the estimate of its state.
    np.testing.assert_allclose(sound, 0.02, rtol=0.25)
    assert (spurious > 2 * sound).all()
    assert "Predicted up to 0.714 s ahead" in result.predicted
    assert "spurious e-fold in 0.24 s" in result.predicted
    assert "sound e-fold" not in result.predicted


def test_slow_growth_and_stable_models_are_simulated_over_the_whole_record():
    slow = replace(STABLE, A=[[0.1, 2.0], [-2.0, 0.1]])
    result = validate({"m": slow, "n": STABLE}, [flown(slow)])
    assert result.horizon == (np.inf,)
    assert result.predicted == ""
    assert np.isfinite(result.simulated["m"][0]).all()
    np.testing.assert_allclose(result.rms["m"][0], 0.02, rtol=0.1)


def test_the_least_unstable_of_those_that_grow_sets_the_horizon_of_all():
    record = flown()
    both = validate({"m": with_spurious(1.0), "n": with_spurious(4.2)}, [record])
    assert both.horizon == (pytest.approx(min(FOLDS, AHEAD * record.duration)),)
    asked = validate({"m": STABLE}, [record], horizon=0.5)
    assert asked.horizon == (0.5,)
    assert asked.predicted.startswith("Predicted up to 0.5 s ahead")
    assert "unstable" not in asked.predicted
    with pytest.raises(ValueError, match="too short to predict 20 s ahead"):
        validate({"m": STABLE}, [record], horizon=20.0)
    with pytest.raises(ValueError, match=r"none within a horizon of 0\.001 s"):
        validate({"m": STABLE}, [record], horizon=0.001)


def test_growth_of_a_discrete_system_is_that_of_the_continuous_one():
    z = np.exp((0.7 + 2j) * 0.1)
    discrete = StateSpace([[z.real, z.imag], [-z.imag, z.real]], [[0.0], [1.0]], np.eye(2),
                          np.zeros((2, 1)), 0.1)  # fmt: skip
    assert growth_rate(discrete) == pytest.approx(0.7)
    assert growth_rate(STABLE) == 0.0


def regulated(seed, n=1500):
    """An unstable aircraft in gusts, flown by a controller that sees noisy outputs."""
    rng = np.random.default_rng(seed)
    system = StateSpace([[0.0, 1.0], [4.0, -0.5]], [[0.0], [5.0]], np.eye(2), np.zeros((2, 1)),
                        inputs=("u",), outputs=("a", "b"))  # fmt: skip
    steps = system.steps(np.array([0.0, DT]), np.zeros((2, 1)), "zoh")
    Ad, Bd = steps.maps[0], system.steps(np.array([0.0, DT]), np.ones((2, 1)), "zoh").forcing[0]
    x, u, y = np.zeros(2), np.zeros((n, 1)), np.zeros((n, 2))
    for k in range(n):
        y[k] = x + 0.01 * rng.standard_normal(2)
        u[k] = -2.0 * y[k, 0] - 0.6 * y[k, 1]
        x = Ad @ x + Bd * u[k] + (0.0, 0.15) * rng.standard_normal(2)
    return system, Record(DT * np.arange(n), u, y, ("u",), ("a", "b"), f"{seed}", hold="zoh")


def doublet(system, begin, n=600):
    """An unstable aircraft in calm air after its pilot's doublet, controlled by noisy outputs."""
    rng, t = np.random.default_rng(11), DT * np.arange(n)
    steps = system.steps(np.array([0.0, DT]), np.ones((2, 1)), "zoh")
    Ad, Bd = steps.maps[0], steps.forcing[0]
    pilot = 0.1 * (((t > begin) & (t <= begin + 1)) - 1.0 * ((t > begin + 1) & (t <= begin + 2)))
    x, u, y = np.zeros(2), np.zeros((n, 1)), np.zeros((n, 2))
    for k in range(n):
        y[k] = x + (0.003, 0.004) * rng.standard_normal(2)
        u[k] = pilot[k] - 1.2 * y[k, 0] - 0.5 * y[k, 1]
        x = Ad @ x + Bd * u[k]
    return Record(t, u, y + np.array([0.05, -0.02]), ("u",), ("a", "b"), "doublet", hold="zoh")


UPRIGHT = StateSpace([[0.0, 1.0], [1.6, -1.0]], [[0.0], [5.0]], np.eye(2), np.zeros((2, 1)),
                     inputs=("u",), outputs=("a", "b"))  # fmt: skip


@pytest.mark.parametrize("closed_loop", [False, True])
@pytest.mark.parametrize("begin", [1.3, 8.0])
def test_a_doublet_flown_early_in_a_short_record_is_judged(begin, closed_loop):
    models = {"truth": UPRIGHT, "weak": replace(UPRIGHT, B=0.5 * UPRIGHT.B)}
    result = validate(models, doublet(UPRIGHT, begin), closed_loop=closed_loop)
    (horizon,), (first,) = result.horizon, result.begins
    assert horizon == pytest.approx(AHEAD * 11.98)
    assert (first * DT < begin + 0.1) if begin < 3 * horizon else (first * DT > 3 * horizon)
    assert (result.theil["truth"] < 0.12).all()
    assert (result.theil["weak"] > 2 * result.theil["truth"]).all()
    # Noise of 0.003 and 0.004: the state at the first start errs by less.
    assert (result.rms["truth"] < 1.2 * np.array([0.003, 0.004])).all()
    assert result.missed == ""


def test_an_output_that_moved_before_the_first_prediction_has_no_verdict():
    result = validate({"truth": UPRIGHT}, doublet(UPRIGHT, -1.7))
    assert np.isfinite(result.rms["truth"]).all()
    assert np.isnan([result.theil["truth"], result.fit["truth"]])[:, 0].tolist() == 2 * [
        [False, True]
    ]
    assert np.isnan(measures(result, "truth", 1)).tolist() == [False, True, True]
    assert np.isfinite(measures(result, "truth", 0)).all()
    assert result.predicted.endswith("before the predictions: b of doublet.")


def test_a_record_that_moves_all_along_is_predicted_after_three_horizons():
    record = flown()
    far = prediction_plan([with_spurious(1.0)], record, 0.5)
    assert far.starts == tuple(range(75, record.N - 1, 25))


def smoothed(system, record, known, start, end):
    """States ahead by least squares over the state at the start and all disturbances ahead."""
    steps = system.steps(record.t, record.u, record.hold)
    (Ad,), level, count = steps.maps, known.likeliest[0], end - start
    P, Q = known.P[level], known.Q[level]
    make = np.zeros((count + 1, 2, 2 * (count + 1)))  # of each state by x0 and every w
    make[0, :, :2] = np.eye(2)
    path = [known.x]
    for k in range(count):
        make[k + 1] = Ad @ make[k]
        make[k + 1, :, 2 * k + 2 : 2 * k + 4] = np.eye(2)
        path.append(Ad @ path[-1] + steps.forcing[start + k])
    root = np.linalg.cholesky(P)
    prior = scipy.linalg.block_diag(
        np.linalg.inv(root), np.diag(np.tile(np.diag(Q) ** -0.5, count))
    )
    at = np.unique(np.linspace(0, count, INSTANTS + 1).round().astype(int)[1:])
    elsewhere = np.r_[: start + 1, end + 1 : record.N]
    mean, apart = record.y[elsewhere].mean(axis=0), np.zeros_like(record.y)
    apart[elsewhere] = (record.y[elsewhere] - mean) / np.sqrt(len(elsewhere))
    usual = np.block(
        [
            [
                apart[max(i - j, 0) : record.N + min(i - j, 0)].T
                @ apart[max(j - i, 0) : record.N + min(j - i, 0)]
                for j in at
            ]
            for i in at
        ]
    )
    noise = np.diag(np.tile(known.r, len(at)))
    spread = np.linalg.inv(np.linalg.cholesky(usual + noise))
    last = spread @ make[at].reshape(2 * len(at), -1)
    wanted = spread @ (mean - np.array(path)[at] - known.bias).ravel()
    found = np.linalg.lstsq(np.vstack([prior, last]), np.append(np.zeros(len(prior)), wanted))[0]
    return np.array(path) + make @ found


@pytest.mark.second
def test_in_closed_loop_states_ahead_are_those_of_least_squares_over_disturbances_ahead():
    system, record = regulated(1)
    scale = record.y.std(axis=0)
    far = prediction_plan([system], record, 1.0, closed_loop=True)
    found = predict(system, record, scale, far).states
    follower = RecordPredictor(system, record, scale)
    ends = (*far.starts[1:], record.N - 1)
    for start, end, known in zip(far.starts, ends, follower.known(far.starts), strict=True):
        wanted = smoothed(system, record, known, start, end)[1:]
        np.testing.assert_allclose(found[start + 1 : end + 1], wanted, rtol=1e-5, atol=1e-7)


def test_inputs_of_a_controller_tell_of_disturbances_ahead():
    system, record = regulated(2)
    alone, told = (
        validate({"truth": system}, [record], horizon=2.0, closed_loop=each)
        for each in (False, True)
    )
    # The mean has 0 %. The truth grows by e^3.5 in 2 s, and disturbances with it.
    assert (told.fit["truth"] > 10).all()
    assert (alone.fit["truth"] < -100).all()
    assert "inputs ahead that keep outputs bounded" in told.predicted
    assert "bounded" not in alone.predicted
    assert "Predictions of a, b are worse than their means" in alone.predicted
    assert "worse than" not in told.predicted


@pytest.mark.second
def test_a_record_in_which_an_output_rests_does_not_make_growth_doubtful():
    # The truth grows and is flown by nobody; in the second record there is nothing but noise.
    truth = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], inputs=("lat",), outputs=("p",))
    t, rng = 0.05 * np.arange(300), np.random.default_rng(3)
    stick = 0.1 * np.sign(np.sin(1.5 * t))[:, None]
    records = [
        Record(
            t,
            u,
            truth.simulate(t, u) + 0.02 * rng.standard_normal((300, 1)),
            ("lat",),
            ("p",),
            name,
        )
        for name, u in (("moved", stick), ("rest", np.zeros_like(stick)))
    ]
    found = validate({"truth": truth}, records, horizon=3.0)
    (moved,), (rested,) = found.fit["truth"]
    assert moved > 90
    assert rested < 0
    assert not found.adrift
    for rate, told in ((0.7, False), (0.8, True)):  # better and worse than the mean, by 24 and 31 %
        wrong = replace(truth, A=np.array([[rate]]))
        said = validate({"wrong": wrong}, records, horizon=3.0).adrift
        assert ("Predictions of p are worse" in said) == told


@pytest.mark.second
def test_expecting_outputs_where_a_controller_keeps_them_excuses_no_wrong_input():
    system, record = regulated(3)
    models = {"truth": system} | {
        f"{gain:g}": replace(system, B=gain * system.B) for gain in (-1.0, 0.3, 3.0)
    }
    found = validate(models, [record], horizon=2.0, closed_loop=True).fit
    for name in list(models)[1:]:
        assert (found["truth"] > found[name] + 5).all(), (name, found)


def test_a_prediction_of_a_stable_model_starts_from_its_own_state():
    x0 = np.array([0.7, -0.4])
    y = STABLE.simulate(T, steps(), x0) + np.array([0.2, -0.1])
    record = Record(T, steps(), y, ("u",), ("a", "b"))
    found = predict(STABLE, record, np.ones(2), prediction_plan([STABLE], record, None))
    np.testing.assert_allclose(found.x0, x0, atol=1e-9)
    np.testing.assert_allclose(found.b, [0.2, -0.1], atol=1e-9)
    np.testing.assert_allclose(found.y, y, atol=1e-9)


@pytest.mark.parametrize("rate", [-0.3, 0.05, 3.0])
@pytest.mark.parametrize("N", [2, 3, 50, 1500])
def test_responses_from_both_ends_obey_the_model_and_stay_small(rate, N):
    system, record = with_spurious(rate), flown().take(slice(0, N))
    follower = RecordPredictor(system, record, np.ones(2))
    z = follower._states()
    ahead = follower.steps.maps[0] @ z[:-1]
    ahead[:, :, 0] += follower.steps.forcing
    np.testing.assert_allclose(z[1:], ahead, atol=1e-11)
    assert np.abs(z).max() < 5.0
    # The same step by step, as where samples are uneven.
    follower.steps = replace(
        follower.steps,
        maps=[*follower.steps.maps, follower.steps.maps[0]],
        which=np.arange(N - 1) % 2,
    )
    np.testing.assert_allclose(follower._states(), z, atol=1e-11)
