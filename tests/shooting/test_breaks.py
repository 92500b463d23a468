"""Inputs that break between samples, whatever a structure makes of them: against SciPy."""

import numpy as np
import pytest
from truths.thrust import Rooted, Saturating, Squared, Thrust, climbed, flown

from casid import OutputError, output_error, validate
from casid.free import Free
from casid.shooting.intervals import lay_out
from casid.shooting.nonlinear import NonlinearEvaluator
from casid.shooting.sensitivity import Point
from casid.shooting.simulation import simulate

DT, N = 0.05, 60  # the edges are one sample steep, or jumps
BENT = [Squared, Rooted, Saturating, Thrust]


def late_by(samples):
    """Parameters with the command so many sampling intervals late, the brake another way."""
    return np.array([9.0, 0.3, 5.0, samples * DT, (samples + 0.37) * DT if samples else 0.0])


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:simulate. outputs")  # a root's still move by a millionth
@pytest.mark.parametrize("samples", [0.0, 0.3, 1.0, 2.25, 6.5])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("cls", BENT)
def test_a_simulation_is_that_of_scipy_from_break_to_break(cls, hold, samples):
    for irregular in (False, True):
        lam = late_by(samples)
        record = flown(cls, lam, hold, n=N, irregular=irregular)
        start = dict(zip(cls.states, record.y[0], strict=True))
        y = simulate(cls().with_vector(lam), record, start).y
        assert (np.abs(y - record.y).max(axis=0) < 1e-6 * np.abs(record.y).max(axis=0)).all()


@pytest.mark.repeats(4)
@pytest.mark.second
@pytest.mark.parametrize("samples", [0.3, 2.25, 6.6])
@pytest.mark.parametrize(("cls", "hold", "near"), [
    (Squared, "foh", 1e-5), (Saturating, "foh", 1e-5),
    (Squared, "zoh", 1e-5), (Saturating, "zoh", 1e-5), (Rooted, "zoh", 1e-5),
    (Rooted, "foh", 1e-3),  # the slope by the delay is infinite where the command leaves zero
])  # fmt: skip
def test_sensitivities_are_differences_of_scipys_solutions(cls, hold, samples, near):
    lam = late_by(samples)
    record, step = flown(cls, lam, hold, n=N), 1e-5
    free = Free(cls(), np.arange(5), np.full(5, -np.inf), np.full(5, np.inf), np.ones(5))
    evaluator = NonlinearEvaluator(free, lay_out([record], 1e9), 1).finer(32)
    point = Point(lam=lam, bias=np.zeros((1, 2)), nodes=record.y[:1])
    sweep = evaluator.sweep(point, evaluator.simulate(point), np.eye(2)[None])
    rows = np.zeros((N, 2, 5))

    def take(_, first, found):
        rows[first : first + len(found)] = found[..., :5].reshape(len(found), 2, 5)

    sweep.run(np.array([0]), take)
    for i, d in enumerate(step * np.eye(5)):
        ahead, behind = (climbed(cls, z, record.t, record.u, hold) for z in (lam + d, lam - d))
        slope = (ahead - behind) / (2 * step)
        assert np.abs(rows[..., i] - slope).max() < near * np.abs(slope).max()


@pytest.mark.second
@pytest.mark.parametrize("hold", ["foh", pytest.param("zoh", marks=pytest.mark.campaign)])
def test_what_halving_the_steps_is_told_to_change_is_the_error_of_the_integration(hold):
    lam = np.array([9.0, 0.3, 5.0, 2.65 * DT, 1.4 * DT])
    noise, rng = {"w": 0.02, "n": 0.01}, np.random.default_rng(4)
    record = flown(Squared, lam, hold, n=200).with_noise(noise, rng)
    fits = [OutputError(steps=n).fit(Squared(), record) for n in (1, 16)]
    for row, truth in zip(fits[0].parameters, lam, strict=True):
        assert abs(row.value - truth) < 3.5 * row.cramer_rao
    moved = {
        name: abs(fits[1][name].value - fits[0][name].value) / fits[1][name].cramer_rao
        for name in fits[0].free_names
    }
    told = fits[0].notes.integration
    assert told.shift < 0.05
    assert told.shift == pytest.approx(max(moved.values()), rel=0.15)


@pytest.mark.second
@pytest.mark.parametrize("hold", ["zoh", pytest.param("foh", marks=pytest.mark.campaign)])
def test_a_root_of_an_input_that_comes_from_zero_is_no_obstacle(hold):
    lam = np.array([9.0, 0.3, 5.0, 2.65 * DT, 1.4 * DT])
    noise, rng = {"w": 0.02, "n": 0.01}, np.random.default_rng(5)
    record = flown(Rooted, lam, hold, n=200).with_noise(noise, rng)
    fit = output_error(Rooted(), record)
    for row, truth in zip(fit.parameters, lam, strict=True):
        assert abs(row.value - truth) < 3.5 * row.cramer_rao
    assert fit.notes.integration.shift <= 1e-4


def test_records_of_either_hold_are_simulated_together_as_alone():
    """Jumps cut the steps of `Thrust`, kinks do not: ways apart over one layout."""
    lam = late_by(2.25)
    records = [flown(Thrust, lam, hold, n=N, irregular=True) for hold in ("foh", "zoh")]
    free = Free(Thrust(), np.arange(5), np.full(5, -np.inf), np.full(5, np.inf), np.ones(5))

    def residuals(of):
        evaluator = NonlinearEvaluator(free, lay_out(of, 1e9), 2).finer(2)
        nodes = np.array([record.y[0] for record in of])
        return evaluator.simulate(Point(lam, np.zeros((len(of), 2)), nodes)).residuals

    both = residuals(records)
    for mine, record in zip(np.split(both, 2), records, strict=True):
        np.testing.assert_allclose(mine, residuals([record]), atol=1e-14)
        assert np.abs(mine).max() < 1e-6


@pytest.mark.second
@pytest.mark.parametrize("horizon", [np.inf, 1.0])
def test_validation_and_predictions_hear_jumps_where_they_are(horizon):
    lam = late_by(2.65)
    record = flown(Rooted, lam, "zoh", n=300)
    noise = {"w": 1e-3, "n": 1e-3}
    noisy = record.with_noise(noise, np.random.default_rng(6))
    found = validate({"true": Rooted().with_vector(lam)}, [noisy], horizon=horizon)
    limit = 1.1e-3 if horizon > 1.0 else 2e-3  # a start that the past tells is no better
    assert found.rms["true"].max() < limit
