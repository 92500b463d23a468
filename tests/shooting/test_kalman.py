"""The Kalman filter of process noise against a recursion and a Riccati solver of other hands."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from truths.closed_roll import TRUTH, flown, jittered, noisy, with_holes

from benchmarks.turbulence import cases, fly, innovations, run
from casid import ConvergenceError, output_error
from casid.free import free_parameters
from casid.shooting.innovation import starting_noises
from casid.shooting.intervals import lay_out
from casid.shooting.sensitivity import Evaluator, Point
from casid.shooting.stepping import Steps, collect_breaks

FREE = free_parameters(TRUTH)


def filtered(records, rise=100.0, interval=1e9):
    """Evaluator of a filter with process noise, and its unknowns."""
    more = starting_noises(TRUTH, records, "full").raised(rise)
    start = more.start + 0.1 * np.random.default_rng(4).standard_normal(len(more.start))
    evaluator = Evaluator(FREE, lay_out(records, interval), replace(more, start=start))
    return evaluator, np.concatenate([FREE.guess, start])


def noise_over(A, Q, h):
    """A_d and Q_d over a step, by Van Loan's exponential."""
    n = len(A)
    E = scipy.linalg.expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * h)
    return E[n:, n:].T, E[n:, n:].T @ E[:n, n:]


def test_the_gain_ends_as_that_of_the_riccati_equation():
    record = flown(t=0.02 * np.arange(2000), seed=1)
    evaluator, lam = filtered([record])
    m, gains = evaluator.matrices(lam), evaluator.gains(lam)
    assert len(gains.K) < record.N  # one gain serves the rest
    Ad, Qd = noise_over(m.A, np.diag(m.Q), record.dt)
    P = scipy.linalg.solve_discrete_are(Ad.T, m.C.T, Qd, m.R)
    S = m.C @ P @ m.C.T + m.R
    np.testing.assert_allclose(gains.S[-1], S, rtol=1e-7)
    np.testing.assert_allclose(gains.K[-1], Ad @ P @ m.C.T @ np.linalg.inv(S), rtol=1e-6)


def test_the_likelihood_is_that_of_a_filter_written_out_whatever_is_missing():
    record = jittered(with_holes(noisy(1).between(0, 4)))
    evaluator, lam = filtered([record])
    m = evaluator.matrices(lam)
    x0, bias = np.array([0.3, -0.02, 0.01]), np.array([0.1, 0.01, -0.02])
    motion = evaluator.simulate(Point(lam, bias[None], x0[None]))
    told = evaluator.gains(lam).cost(motion.residuals)
    # It corrects the states at a sample, then predicts; what inputs do is tested elsewhere.
    held = evaluator.held(m)
    breaks = collect_breaks(held, [record.hold], m.A)
    forcing = Steps(m, evaluator.layout, held, breaks, True).forcing()
    P, x, cost = np.zeros((3, 3)), x0, 0.0
    step = np.median(np.diff(record.t))
    Ad, Qd = noise_over(m.A, np.diag(m.Q), np.diff(record.t)[0])
    for _ in range(round(2 / step)):  # two seconds earlier it began
        L = P @ m.C.T @ np.linalg.inv(m.C @ P @ m.C.T + m.R)
        P = Ad @ (P - L @ m.C @ P) @ Ad.T + Qd
    for k in range(record.N):
        np.testing.assert_allclose(x, motion.states[k], rtol=1e-8, atol=1e-10)
        seen = np.isfinite(record.y[k])
        C, R = m.C[seen], m.R[np.ix_(seen, seen)]
        e = record.y[k, seen] - (m.C @ x + m.D @ held[0].value[k] + bias)[seen]
        S = C @ P @ C.T + R
        if seen.any():
            cost += (e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1]) / 2
        L = P @ C.T @ np.linalg.inv(S) if seen.any() else np.zeros((3, 0))
        x, P = x + L @ e, P - L @ C @ P
        if k + 1 < record.N:
            Ad, Qd = noise_over(m.A, np.diag(m.Q), record.t[k + 1] - record.t[k])
            x, P = Ad @ x + forcing[k], Ad @ P @ Ad.T + Qd
    assert told == pytest.approx(cost, rel=1e-9)


def test_the_filter_begins_as_early_before_every_record_whatever_its_sampling():
    fine, coarse = noisy(1).between(0, 4), noisy(2).between(0, 4)
    coarse = replace(coarse, t=coarse.t[::5], u=coarse.u[::5], y=coarse.y[::5])
    evaluator, lam = filtered([fine, coarse])
    m, R = evaluator.matrices(lam), evaluator.gains(lam)
    for record, first in ((fine, 0), (coarse, fine.N)):
        Ad, Qd = noise_over(m.A, np.diag(m.Q), record.dt)
        P = np.zeros((3, 3))
        for _ in range(round(2 / record.dt)):
            L = P @ m.C.T @ np.linalg.inv(m.C @ P @ m.C.T + m.R)
            P = Ad @ (P - L @ m.C @ P) @ Ad.T + Qd
        np.testing.assert_allclose(R.S[R.which[first]], m.C @ P @ m.C.T + m.R, rtol=1e-8)


def test_gains_and_covariances_follow_every_unknown_also_where_channels_are_missing():
    record = with_holes(noisy(1).between(0, 1.5))
    evaluator, lam = filtered([record])
    there = evaluator.gains(lam, slopes=True)
    assert not there.S_lam[there.which[0]].any(axis=(0, 1)).all()  # B moves no covariance
    for i in range(len(lam)):
        step = 1e-5 * max(1.0, abs(lam[i])) * np.eye(len(lam))[i]
        ahead, behind = (evaluator.gains(lam + sign * step) for sign in (1, -1))
        for name in ("K", "S"):
            slope = getattr(there, f"{name}_lam")[there.which, ..., i]
            both = (getattr(g, name)[g.which] for g in (ahead, behind))
            by_difference = np.subtract(*both) / (2 * step[i])
            size = max(np.abs(by_difference).max(), 1e-6 * np.abs(getattr(there, name)).max())
            np.testing.assert_allclose(slope, by_difference, atol=1e-5 * size)


@pytest.mark.slow
def test_in_still_air_the_filter_is_output_error():
    records = [noisy(1).between(0, 6), noisy(2).between(0, 6)]
    plain = output_error(TRUTH, records)
    fit = output_error(TRUTH, records, process_noise=True)
    assert fit.success
    assert fit.method == "filter error"
    assert fit.cost <= plain.cost + 1e-3
    for one, other in zip(fit.parameters, plain.parameters, strict=True):
        assert abs(one.value - other.value) < other.std_error


def test_covariances_know_of_the_first_process_noise_there_is():
    # P = 0 stays so without noise, but what the least of it makes goes on growing.
    record = noisy(1).between(0, 3)
    evaluator, lam = filtered([record])
    lam[len(FREE.index) : len(FREE.index) + 3] = 0.0
    there, step = evaluator.gains(lam, slopes=True), 1e-6
    for i in range(len(FREE.index), len(FREE.index) + 3):
        ahead = evaluator.gains(lam + step * np.eye(len(lam))[i])
        by_difference = (ahead.S[ahead.which] - there.S[there.which]) / step
        slope = there.S_lam[there.which, ..., i]
        assert len({*slope[:, 1, 1]}) == record.N  # every sample has its own
        np.testing.assert_allclose(slope, by_difference, atol=1e-3 * by_difference.max())


@pytest.mark.campaign
def test_still_air_is_told_over_a_growing_mode():
    case = cases()["2 states, 2 outputs"]
    still = replace(case, density=np.full(2, 1e-30), N=400)
    record = fly(still, np.random.default_rng(1), "still air")
    plain = output_error(case.truth, record)
    fit = output_error(case.truth, record, process_noise=True)
    assert not fit.notes.process_noise.any()
    assert fit.cost == pytest.approx(plain.cost, abs=1e-4)
    np.testing.assert_allclose(fit.model.vector(), plain.model.vector(), rtol=1e-5)


@pytest.mark.slow
def test_turbulence_that_steps_from_output_error_miss_is_not_taken_for_still_air():
    # No first bit of process noise helps there, much of it does: by 136 of log-likelihood.
    case = replace(cases()["2 states, 2 outputs"], N=120)
    record = fly(case, np.random.default_rng([60, 6]), "short")
    fit = output_error(case.start(case.truth), record, process_noise=True)
    assert fit.notes.process_noise[0] > 0.03
    assert fit.cost < output_error(case.start(case.truth), record).cost - 100


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [2, 3])
def test_turbulence_that_seems_to_drive_another_state_is_found_out(seed):
    # From output error alone the search ends where noise drives the attitude, up to 70 of
    # log-likelihood worse, with derivatives eight stated errors off.
    case = replace(cases()["2 states, 2 outputs"], N=120)
    record = fly(case, np.random.default_rng([seed, 77]), "short")
    fit = output_error(case.start(case.truth), record, process_noise=True)
    best = output_error(case.truth, record, process_noise=True)
    assert fit.cost < best.cost + 1e-3
    errors = np.array([row.std_error for row in fit.parameters])
    assert (np.abs(fit.model.vector() - case.truth.vector()) < 3 * errors).all()
    assert np.sqrt(fit.notes.process_noise[0]) == pytest.approx(0.3, rel=0.25)


@pytest.mark.campaign
def test_a_noise_that_the_records_do_not_show_ends_at_none():
    # From the guess in turbulence it stays at .26 m/s/√s, as likely as none but for .33.
    case = replace(cases()["4 states, 4 outputs"], N=200)
    fit = run(case, 502)[2]
    assert fit.notes.process_noise[0] < 1e-6


@pytest.mark.slow
def test_without_measurement_noise_the_likelihood_degenerates_and_the_best_is_told():
    records = [flown(seed=1).between(0, 6), flown(seed=2).between(0, 6)]
    with pytest.raises(ConvergenceError, match="predicted exactly") as caught:
        output_error(TRUTH, records, process_noise=True)
    np.testing.assert_allclose(caught.value.best.model.vector(), TRUTH.vector(), rtol=1e-3)


@pytest.mark.second
def test_turbulence_is_told_from_measurement_noise():
    case = cases()["2 states, 2 outputs"]
    record = fly(case, np.random.default_rng(5), "gusts")
    fit = output_error(case.start(case.truth), record, process_noise=True)
    e, S = innovations(
        case, record,
        np.concatenate([fit.model.vector(), np.log(np.maximum(fit.notes.process_noise, 1e-30)),
                        np.log(np.diag(fit.R))]),
        fit.initial_states[0], fit.biases[0],
    )  # fmt: skip
    cost = (np.einsum("ka,kab,kb->", e, np.linalg.inv(S), e) + np.linalg.slogdet(S)[1].sum()) / 2
    assert fit.cost == pytest.approx(cost, abs=1e-4)
    # Of a thousand samples: a variance is known to 5 % or so, and its share in two to more.
    np.testing.assert_allclose(np.sqrt(np.diag(fit.R)), case.sigma, rtol=0.35)
    assert np.sqrt(fit.notes.process_noise[0]) == pytest.approx(0.3, rel=0.15)
