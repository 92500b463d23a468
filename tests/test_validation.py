"""Validation: least-squares initial states and biases, and measures against their formulas."""

from dataclasses import replace

import numpy as np
import pytest

from casid import BlackBox, Fit, Model, OutputError, Record, Rows, Scalar, StateSpace, parameter
from casid.estimates import parameter_table
from casid.free import free_parameters
from casid.linear import foh_step
from casid.validation import Validation, measures, validate

DT = 0.02
T = DT * np.arange(600)

# A roll axis with an unstable oscillation slow enough to be simulated open loop: 0.1 ± 0.43j.
A = np.array([[-0.1, 0.2, 9.81], [-0.05, -3.0, 0.0], [0.0, 1.0, 0.0]])
TRUTH = StateSpace(
    A, [[0.0], [5.0], [0.0]], [[0, 1.0, 0], [0, 0, 1.0]], [[0.0], [0.0]],
    inputs=("lat",), outputs=("p", "phi"),
)  # fmt: skip
X0, BIAS = np.array([0.5, -0.1, 0.05]), np.array([0.02, -0.3])


def doublet(t):
    return np.where((t > 1) & (t < 2), 0.1, 0.0) - np.where((t >= 2) & (t < 3), 0.1, 0.0)


def flown(system=TRUTH, t=T, x0=X0, bias=BIAS, noise=0.0, name="doublet"):
    u = np.column_stack([doublet(t)] * system.nu)
    y = system.simulate(t, u, x0) + bias
    y = y + noise * np.random.default_rng(3).standard_normal(y.shape)
    return Record(t, u, y, system.inputs, system.outputs, name)


def only(result: Validation, measure: str, name: str = "m"):
    return getattr(result, measure)[name][0]


def test_records_too_short_for_biases_are_not_without_any():
    record = flown(t=T[:7], bias=[0.0, 0.0])  # 14 samples for 3 states, or 3 and 2 biases
    with pytest.raises(ValueError, match="14 measurements for 5 initial states and biases"):
        validate({"m": TRUTH}, [record])
    assert only(validate({"m": TRUTH}, [record], biases=False), "rms").max() < 1e-11


def test_the_truth_leaves_no_residual_and_finds_state_and_biases():
    result = validate({"m": TRUTH}, [flown()])
    # Rounding of signals of size 1-10 through a least-squares problem of condition about 1e3.
    assert only(result, "rms").max() < 1e-11
    np.testing.assert_allclose(result.initial_states["m"][0], X0, atol=1e-10)
    np.testing.assert_allclose(only(result, "biases"), BIAS, atol=1e-10)
    np.testing.assert_allclose(only(result, "fit"), 100, atol=1e-7)
    assert only(result, "theil").max() < 1e-10


@pytest.mark.parametrize("pole", [0.3, 1.0, 4.0])
def test_an_unstable_model_follows_its_own_closed_loop_record(pole):
    # e^{4·40} = 1e69: open-loop simulation from an estimated initial state would be rounding alone.
    A = np.array([[pole, 1.0], [0.0, -2.0]])
    B, C = np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    t = DT * np.arange(2000)
    Ad, B0, B1 = foh_step(A, B, DT)
    gain = np.array([[(pole + 2) * (pole + 3), pole + 3]])  # closed-loop poles -2 and -3
    x, u, y = np.array([0.01, 0.0]), np.empty((2000, 1)), np.empty((2000, 1))
    for k in range(2000):
        u[k] = doublet(t[k]) - gain @ x
        y[k] = C @ x
        x = Ad @ x + (B0 + B1) @ u[k]
    record = Record(t, u, y, ("stick",), ("x",), "closed loop", hold="zoh")
    system = StateSpace(A, B, C, [[0.0]], inputs=("stick",), outputs=("x",))
    result = validate({"m": system}, [record])
    assert only(result, "rms")[0] < 1e-11 * np.abs(y).max() * (pole + 3) ** 2  # the loop's gain
    np.testing.assert_allclose(result.initial_states["m"][0], [0.01, 0.0], atol=1e-9)


@pytest.mark.parametrize("biased", [("p", "phi"), ("phi",), ()])
def test_state_and_biases_are_those_of_ordinary_least_squares(biased):
    record = flown(noise=0.02)
    y = record.y.copy()
    y[::7, 0] = np.nan
    record = replace(record, y=y)
    wrong = replace(TRUTH, A=A * 1.1)
    result = validate({"m": wrong}, [record], biases=biased)
    rest = np.zeros_like(record.u)
    forced = wrong.simulate(T, record.u)
    columns = [wrong.simulate(T, rest, e) for e in np.eye(3)]
    columns += [np.broadcast_to([name == own for own in TRUTH.outputs], y.shape) for name in biased]
    weight = 1 / np.nanstd(y, axis=0)
    there = ~np.isnan(y)
    regressor = np.column_stack([(column * weight)[there] for column in columns])
    expected = np.linalg.lstsq(regressor, ((y - forced) * weight)[there])[0]
    np.testing.assert_allclose(result.initial_states["m"][0], expected[:3], rtol=1e-8)
    found = dict(zip(TRUTH.outputs, only(result, "biases"), strict=True))
    np.testing.assert_allclose([found.pop(name) for name in biased], expected[3:], rtol=1e-8)
    assert (set(found.values()) <= {0.0}, result.unbiased) == (True, tuple(found))
    assert np.isfinite(result.simulated["m"][0]).all()  # also where the measurement is missing


def test_measures_are_their_formulas():
    record = flown(noise=0.05)
    result = validate({"m": replace(TRUTH, A=1.05 * A)}, [record])
    y, s = record.y, result.simulated["m"][0]
    np.testing.assert_allclose(only(result, "rms"), np.sqrt(((y - s) ** 2).mean(axis=0)))
    power = ((y - y.mean(axis=0)) ** 2).sum(axis=0)
    expected = 100 * (1 - np.sqrt(((y - s) ** 2).sum(axis=0) / power))
    np.testing.assert_allclose(only(result, "fit"), expected)
    for trim, datum in (({}, y.mean(axis=0)), ({"p": 5.0, "phi": 0.1}, 0.0)):
        result = validate({"m": replace(TRUTH, A=1.05 * A)}, [replace(record, trim=trim)])
        size = (np.sqrt(((each - datum) ** 2).mean(axis=0)) for each in (y, s))
        np.testing.assert_allclose(only(result, "theil"), only(result, "rms") / sum(size))


def test_total_values_of_several_records_are_measured_as_deviations_from_their_means():
    slow, fast = flown(noise=0.05, name="slow"), flown(noise=0.05, name="fast")
    apart = [1.1 * record.y for record in (slow, fast)]
    totals = [
        replace(record, y=record.y - record.y.mean(axis=0) + level)
        for record, level in ((slow, 30.0), (fast, 50.0))
    ]
    moved = [
        y - 1.1 * record.y.mean(axis=0) + level
        for y, record, level in zip(apart, (slow, fast), (30.0, 50.0), strict=True)
    ]
    whole = validate({"m": TRUTH}, [slow, replace(fast, y=2 * fast.y)])
    for i in range(2):
        y = np.concatenate([record.y[:, i] - record.y[:, i].mean() for record in (slow, fast)])
        seen = replace(whole, measured=tuple(totals), simulated={"m": tuple(moved)})
        _, fit, theil = measures(seen, "m", i)
        assert fit == pytest.approx(90.0)
        assert theil == pytest.approx(np.std(0.1 * y) / (np.std(y) + np.std(1.1 * y)))


def test_rms_is_divided_by_the_worst_model():
    worse = replace(TRUTH, B=2 * TRUTH.B)
    records = [flown(noise=0.01, name="one"), flown(t=T[:400], noise=0.01, name="two")]
    result = validate({"good": TRUTH, "bad": worse}, records)
    assert result.records == ("one", "two")
    assert result.rms["bad"].shape == (2, 2)
    np.testing.assert_array_equal(result.normalised["bad"], np.ones((2, 2)))
    ratio = result.rms["good"] / result.rms["bad"]
    np.testing.assert_allclose(result.normalised["good"], ratio)


def test_perfect_models_have_a_finite_normalised_rms():
    still = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=("a",), outputs=("b",))
    record = Record(T, np.zeros((600, 1)), np.zeros((600, 1)), ("a",), ("b",))
    result = validate({"m": still}, [record])
    assert only(result, "normalised")[0] == 0


def test_white_residuals_pass_and_missed_dynamics_fail_the_whiteness_test():
    record = flown(t=DT * np.arange(2000), noise=0.02)
    result = validate({"truth": TRUTH, "off": replace(TRUTH, B=1.5 * TRUTH.B)}, [record])
    # 40 lags with 1 % outside each: 4 or more outside has a chance of 1e-3 (binomial).
    assert (result.whiteness["truth"] > 0.9).all()
    assert (result.whiteness["off"] < 0.5).all()


def test_a_delayed_model_on_uneven_samples_is_simulated_exactly():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.01, 0.04, 400))
    system = replace(TRUTH, delay=np.array([0.073]))
    result = validate({"m": system}, [flown(system, t)])
    assert only(result, "rms").max() < 1e-10
    np.testing.assert_allclose(result.initial_states["m"][0], X0, atol=1e-9)


def test_continuous_and_discrete_black_boxes_agree():
    Ad, B0, B1 = foh_step(TRUTH.A, TRUTH.B, DT)
    record = replace(flown(noise=0.01), hold="zoh")
    discrete = replace(TRUTH, A=Ad, B=B0 + B1, dt=DT)
    result = validate({"c": box(TRUTH), "d": box(discrete)}, [record])
    np.testing.assert_allclose(result.simulated["c"][0], result.simulated["d"][0], atol=1e-10)


def box(system):
    return BlackBox(
        system=system, K=np.zeros((3, 2)), singular_values=np.ones(3), pole=np.nan, past=8,
        future=8, transform="none", feedthrough=np.zeros((2, 1), dtype=bool),
        input_std=np.ones(1), output_std=np.ones(2), band=(0.1, 10.0), records=("a",),
    )  # fmt: skip


class Roll(Model):
    states = ("v", "p", "phi")
    inputs = ("lat",)
    outputs = ("p", "phi")
    Lp: Scalar = parameter(default=-3.0, lower=-9.0, upper=0.0, unit="1/s")

    def A(self) -> Rows:
        return [[-0.1, 0.2, 9.81], [-0.05, self.Lp, 0], [0, 1, 0]]

    def B(self) -> Rows:
        return [[0], [5], [0]]


def test_structures_and_fits_are_judged_like_their_systems():
    model = Roll()
    table = parameter_table(free_parameters(model), np.array([-3.0]), np.zeros(1))
    fit = Fit(
        model=model, parameters=table, cost=0.0, status="solved", success=True, iterations=1,
        seconds=0.0, method="test", notes=None,
    )  # fmt: skip
    result = validate({"system": TRUTH, "model": model, "fit": fit}, [flown(noise=0.01)])
    np.testing.assert_allclose(result.rms["model"], result.rms["system"], rtol=1e-9)
    np.testing.assert_array_equal(result.rms["model"], result.rms["fit"])


def test_an_output_the_model_lacks_is_nan():
    partial = replace(TRUTH, C=TRUTH.C[1:], D=TRUTH.D[1:], outputs=("phi",))
    result = validate({"all": TRUTH, "part": partial}, [flown(noise=0.01)])
    assert np.isnan(result.rms["part"][0, 0])
    assert np.isfinite(result.rms["part"][0, 1])
    assert np.isnan(result.simulated["part"][0][:, 0]).all()
    assert result.normalised["all"][0, 0] == 1.0


@pytest.mark.second
def test_a_model_that_runs_out_of_numbers_is_never_better_for_it():
    # e^{400·1} over a horizon of 1 s is finite, its square is not; e^{400·3} is not either. Of 2000
    # not even the filter's covariances are.
    record = replace(flown(t=DT * np.arange(1000), noise=0.02), trim={"p": 0.0})
    y = record.y.copy()
    y[600:620, 0] = np.nan
    record = replace(record, y=y)
    for rate, horizon in ((400.0, 1.0), (400.0, 3.0), (2000.0, 1.0)):
        bad = StateSpace([[rate]], [[4.0]], [[1.0]], [[0.0]], None, ("lat",), ("p",))
        result = validate({"truth": TRUTH, "bad": bad}, record, horizon=horizon)
        begin, found = result.begins[0], result.simulated["truth"][0][:, 0]
        there = (np.arange(record.N) >= begin) & ~np.isnan(y[:, 0])
        square = np.mean((y[there, 0] - found[there]) ** 2)
        assert result.rms["truth"][0, 0] == pytest.approx(np.sqrt(square))
        assert measures(result, "truth", 0)[0] == pytest.approx(np.sqrt(square))
        expected = {"rms": np.inf, "fit": -np.inf, "theil": 1, "normalised": 1, "whiteness": 0}
        for measure, value in expected.items():
            assert only(result, measure, "bad")[0] == value
            assert np.isnan(only(result, measure, "bad")[1])  # an output that it lacks
        assert measures(result, "bad", 0) == (np.inf, -np.inf, 1.0)
        assert np.isnan(measures(result, "bad", 1)).all()
        assert only(result, "normalised", "truth")[0] == 0
        assert "bad -inf %" in result.headline()


def test_an_unobservable_mode_does_no_harm():
    hidden = replace(TRUTH, C=[[0, 0, 0], [0, 0, 1.0]])
    result = validate({"m": hidden}, [flown(hidden)])
    assert only(result, "rms").max() < 1e-10


@pytest.mark.parametrize(
    ("models", "message"),
    [
        ({}, "no models given"),
        ({"m": replace(TRUTH, inputs=("ped",))}, "model 'm' has input 'ped', record 'doublet'"),
        ({"m": replace(TRUTH, outputs=("q", "r"))}, "none in common"),
        ({"m": replace(TRUTH, A=np.nan * A)}, "A is not finite"),
        ({"m": replace(TRUTH, dt=0.05)}, "record 'doublet': a discrete model of interval 0.05 s"),
    ],
)
def test_what_cannot_be_validated_is_named(models, message):
    with pytest.raises(ValueError, match=message):
        validate(models, [flown()])


def test_a_record_at_rest_judges_no_fit():
    lag = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], None, ("u",), ("y",))
    still = Record(
        np.arange(50) * 0.1, np.zeros((50, 1)), np.zeros((50, 1)), ("u",), ("y",), "rest"
    )
    assert "mean fit: lag none" in validate({"lag": lag}, still).headline()


def test_predictions_without_a_bias_do_not_learn_an_offset():
    # From 1, which the filters take for the state, predictions of 2 s decay with the model's pole.
    lag = StateSpace([[-4.0]], [[1.0]], [[1.0]], [[0.0]], None, ("u",), ("y",))
    record = Record(T, np.zeros((600, 1)), np.ones((600, 1)), ("u",), ("y",), "off")
    with_, without = (validate({"m": lag}, record, horizon=2.0, biases=b) for b in (True, False))
    tau = DT * np.arange(1, 101)
    assert with_.rms["m"][0, 0] < 1e-3
    expected = np.sqrt(np.mean((1 - np.exp(-4 * tau)) ** 2))
    assert without.rms["m"][0, 0] == pytest.approx(expected, rel=0.05)
    assert (without.biases["m"][0, 0], without.unbiased) == (0.0, ("y",))


@pytest.mark.second
def test_what_was_estimated_without_a_bias_is_judged_without_and_so_is_what_stands_beside():
    records = [flown(x0=0 * X0, bias=0 * BIAS, noise=0.01)]
    exact, free = (OutputError(biases=b).fit(Roll(), records) for b in (["phi"], True))
    shifted = replace(records[0], y=records[0].y + np.array([0.5, 0.0]))
    result = validate({"exact": exact, "m": TRUTH}, shifted)
    assert (exact.unbiased, result.unbiased, free.unbiased) == (("p",), ("p",), ())
    for name in ("exact", "m"):
        assert result.rms[name][0, 0] > 0.1
    freed = validate({"free": free, "m": TRUTH}, shifted)
    np.testing.assert_allclose(freed.rms["free"][0], 0.01, rtol=0.1)
    with pytest.raises(ValueError, match="bias of unknown output 'P'"):
        validate({"m": TRUTH}, shifted, biases=("P",))
