import numpy as np
import pytest
from truths.systems import output_error_record, sampled, sampled_plant, stepped_input

from casid import Record, StateSpace
from casid.records import standard_deviations
from casid.subspace.simulation import refine_simulation

OMEGA = np.linspace(0.1, 2.5, 10)


def simulation_error(system, record):
    """Root mean square of the part no initial state and no constant explain, by output."""
    n, zero = system.nx, np.zeros_like(record.u)
    columns = [system.simulate(record.t, zero, x0=x) for x in np.eye(n)]
    left = record.y - system.simulate(record.t, record.u)
    columns = np.stack([c - c.mean(axis=0) for c in columns], axis=-1).reshape(-1, n)
    left = (left - left.mean(axis=0)).ravel()
    return np.std(
        (left - columns @ np.linalg.lstsq(columns, left)[0]).reshape(record.y.shape), axis=0
    )


def test_simulation_errors_approach_the_noise():
    box = sampled(output_error_record(), 3, "simulation")
    # 12 parameters, 3 initial values and 2 constants of 1200 numbers; noise within 3/√1200.
    np.testing.assert_allclose(simulation_error(box.system, output_error_record()), 0.3, rtol=0.1)
    assert np.abs(box.system.poles()).max() < 1
    np.testing.assert_array_equal(box.K, 0.0)
    np.testing.assert_array_equal(box.system.D, 0.0)


@pytest.mark.second
def test_under_white_output_noise_simulation_errors_are_the_more_efficient():
    errors = {how: [] for how in ("unrefined", "prediction", "simulation")}
    for seed in range(8):
        for how, found in errors.items():
            box = sampled(output_error_record(seed=seed), 3, how)
            found.append(np.abs(box.system.response(OMEGA) - sampled_plant().response(OMEGA)))
    size = {how: np.mean(np.square(found)) for how, found in errors.items()}
    assert size["simulation"] < size["prediction"]
    assert size["simulation"] < size["unrefined"]


def test_an_order_too_low_simulates_better_when_refined_for_it():
    both = output_error_record(noise=0.05)
    record = Record(both.t, both.u, both.y[:, :1], both.inputs, ("a",), hold="zoh")
    error = {
        how: simulation_error(sampled(record, 2, how).system, record)[0]
        for how in ("unrefined", "prediction", "simulation")
    }
    assert error["simulation"] < min(error["unrefined"], error["prediction"])


def test_missing_samples_split_a_record_and_unstable_starts_are_moved_inside():
    record = output_error_record(noise=0.02)
    y = record.y.copy()
    y[200, 0] = np.nan
    gappy = Record(record.t, record.u, y, record.inputs, record.outputs, hold="zoh")
    su, sy = standard_deviations([gappy])
    truth = sampled_plant()
    names = ("stick",), ("rate", "angle")
    start = StateSpace(1.2 * truth.A, truth.B, truth.C, truth.D, 1.0, *names)
    found = refine_simulation(start, [gappy], su, sy, np.zeros((2, 1), dtype=bool))
    assert (found.inputs, found.outputs) == names
    # The noise is some hundredth of the outputs; 600 samples: about 0.1 %, ten times that allowed.
    np.testing.assert_allclose(found.response(OMEGA), truth.response(OMEGA), atol=0.05)


def growing_noise(N=600):
    """Standard deviations from 0.02 to 1."""
    return 0.02 * 50 ** (np.arange(N) / N)


def first_order_record(noise, seed):
    rng, N = np.random.default_rng(seed), len(noise)
    system = StateSpace([[0.8]], [[1.0]], [[1.0]], [[0.0]], 1.0)
    t, u = np.arange(N, dtype=float), stepped_input(N, 1, rng, hold=3)
    y = system.simulate(t, u) + noise[:, None] * rng.standard_normal((N, 1))
    return Record(t, u, y, ("u",), ("y",), hold="zoh")


def pole_bound(record, noise):
    """Cramér-Rao standard deviation of the pole of `first_order_record`."""
    x, slope = np.zeros(record.N), np.zeros(record.N)
    gain, start = np.zeros(record.N), 0.8 ** np.arange(record.N)
    for k in range(record.N - 1):
        x[k + 1] = 0.8 * x[k] + record.u[k, 0]
        slope[k + 1] = 0.8 * slope[k] + x[k]
        gain[k + 1] = 0.8 * gain[k] + record.u[k, 0]
    J = np.column_stack([slope, gain, start, np.ones(record.N)]) / noise[:, None]
    return np.sqrt(np.linalg.inv(J.T @ J)[0, 0])


@pytest.mark.second
def test_local_levels_reach_the_cramer_rao_bound_of_noise_that_grows():
    noise, ratios = growing_noise(), {"simulation": [], "local simulation": []}
    for seed in range(20):
        record = first_order_record(noise, seed)
        for how, found in ratios.items():
            (pole,) = sampled(record, 1, how).system.poles().real
            found.append((pole - 0.8) / pole_bound(record, noise))
    size = {how: np.sqrt(np.mean(np.square(found))) for how, found in ratios.items()}
    # 20 seeds: the root mean square of unit errors is 1 within 3/√40.
    assert size["local simulation"] == pytest.approx(1.0, abs=0.5)
    assert size["simulation"] > 3


@pytest.mark.second
def test_local_levels_of_constant_noise_change_little():
    noise, distance = np.full(600, 0.3), []
    for seed in range(8):
        record = first_order_record(noise, seed)
        kinds = ("simulation", "local simulation")
        poles = [sampled(record, 1, how).system.poles().real[0] for how in kinds]
        distance.append((poles[1] - poles[0]) / pole_bound(record, noise))
    # Levels known within 10 % cost about 1 % of the variance: a tenth of the standard deviation.
    assert np.sqrt(np.mean(np.square(distance))) < 0.4


def test_a_predictor_without_modes_is_refused_and_its_model_still_simulates():
    # As many states as the window has samples: the predictor forgets after so many steps, and its
    # poles all lie at zero.
    record = output_error_record(noise=0.1)
    single = Record(record.t, record.u, record.y[:, :1], ("u",), ("a",), hold="zoh")
    with pytest.raises(ValueError, match=r"cannot be told from one another.*lengthen the past"):
        sampled(single, 12, "prediction", past=12)
    box = sampled(single, 12, "simulation", past=12)
    assert simulation_error(box.system, single) == pytest.approx(0.1, rel=0.1)
