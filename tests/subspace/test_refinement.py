import numpy as np
import pytest
from truths.systems import campaign, innovation_record, unstable_plant

from casid import Record, StateSpace, pbsid
from casid.records import standard_deviations
from casid.subspace import refinement
from casid.subspace.fourier import spectra
from casid.subspace.modal import Modal, mixed, moved, pair, to_modal
from casid.subspace.refinement import (
    ResponseUncertainty,
    information_criteria,
    refine,
    residual_powers,
)

OMEGA = np.geomspace(0.5, 6.0, 12)


def covered(truth, box, omega):
    """Which magnitudes and phases have the truth in their 95 % intervals."""
    size, phase = box.response_std(omega)
    error = np.log(box.system.response(omega) / truth.response(omega))
    return [np.abs(error.real) < 1.96 * size, np.abs(error.imag) < 1.96 * phase]


def projected(seed):
    box = pbsid(campaign(noise=0.03, seed=seed), order=5, past=10, pole=6.0, feedthrough=["z"])
    return covered(unstable_plant(), box, OMEGA)


def sampled(seed):
    truth, _, record, _ = innovation_record(seed=seed)
    box = pbsid([record], order=3, transform="none", feedthrough=False)
    return covered(truth, box, np.linspace(0.1, 2.5, 12))


def multisine(seed, duration):
    """Two states under twelve lines, white noise of a tenth on both outputs."""
    rng, t = np.random.default_rng(seed), np.arange(0, duration, 0.02)
    lines = 2 * np.pi / duration * np.unique(np.round(np.geomspace(0.1, 2.5, 12) * duration))
    phases = np.random.default_rng(99).uniform(0, 7, len(lines))
    u = np.cos(t[:, None] * lines + phases).sum(axis=1)[:, None]
    truth = StateSpace([[-0.8, 2.0], [-2.0, -0.8]], [[1.0], [0.5]], np.eye(2), [[0.0], [0.0]])
    y = truth.simulate(t, u)
    y = y + 0.1 * np.std(y, axis=0) * rng.standard_normal(y.shape)
    return truth, Record(t, u, y, ("u",), ("a", "b"))


@pytest.mark.parametrize("duration", [20.0, 40.0])
def test_stated_errors_are_those_of_many_records_of_few_lines(duration):
    errors, omega = [], np.geomspace(0.7, 12.0, 12)
    for seed in range(40):
        truth, record = multisine(seed, duration)
        box = pbsid(record, order=2, past=8, pole=6.0)
        size, phase = box.response_std(omega)
        error = np.log(box.system.response(omega) / truth.response(omega))
        errors.append([error.real / size, error.imag / phase])
    # 40 records of some six independent parameters: the root mean square is known within 5 %.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.09)
    assert 0.92 <= np.mean(np.abs(errors) < 1.96) <= 0.98


def test_a_few_campaigns_agree_with_the_standard_deviation_of_the_response():
    # 8 campaigns of some 20 independent parameters: the share's own error is about 2.5 %.
    assert 0.9 <= np.mean([projected(seed) for seed in range(8)]) <= 0.99


@pytest.mark.campaign
@pytest.mark.parametrize("run", [projected, sampled])
def test_95_percent_intervals_cover_92_to_98_percent_of_the_truth(run):
    share = np.mean([run(seed) for seed in range(60)])
    print(f"{run.__name__}: {share:.1%}")  # noqa: T201 - quoted in the documentation
    assert 0.92 <= share <= 0.98


def test_residuals_of_the_truth_vanish_whatever_the_end_states():
    plant, record = unstable_plant(), campaign()[0].between(3.0, 17.0)
    su, sy = standard_deviations([record])
    _, power = residual_powers(plant, spectra([record], su, sy, 12.0), su, sy)
    assert power.max() < 1e-16  # rounding, where the outputs' powers are of order one


def test_residuals_are_those_of_least_squares_over_all_lines():
    plant, record = unstable_plant(), campaign(noise=0.05)[0].between(3.0, 17.0)
    su, sy = standard_deviations([record])
    data = spectra([record], su, sy, 12.0)
    _, power = residual_powers(plant, data, su, sy)
    modal = to_modal(plant, su, sy, np.ones(plant.D.shape, dtype=bool))
    factors = refinement.factors(modal, data[0])
    E = refinement.forced(modal, data[0], factors)
    shared = pair(factors.transient[:, :, None], factors.transient_c[:, :, None], modal.real)
    P = np.vstack([mixed(shared, modal, o, 1) for o in range(plant.ny)])
    both = [np.concatenate([v.real, v.imag]) for v in (P, E.T.ravel())]
    delta = np.linalg.lstsq(*both, rcond=None)[0]
    left = (E.T.ravel() - P @ delta).reshape(E.T.shape).T
    np.testing.assert_allclose(power, np.abs(left) ** 2, rtol=1e-8, atol=1e-12 * power.max())


def test_normal_equations_are_those_of_the_profiled_cost():
    # Gauss-Newton is exact where the start is the truth of noise-free data; elsewhere the gradient
    # is that of the cost, the transients at their best.
    records, plant = campaign(records=2), unstable_plant()
    su, sy = standard_deviations(records)
    data = spectra(records, su, sy, 12.0)
    mask = plant.D != 0
    free, rng = np.argwhere(mask), np.random.default_rng(1)
    weights = [rng.uniform(0.5, 2.0, (len(s.omega), 3)) for s in data]
    truth = to_modal(plant, su, sy, mask)

    def cost(modal, step):
        return sum(p.cost for p in refinement._parts(moved(modal, step, free), data, weights))

    H, gradient = refinement.normal_equations(truth, data, weights, free)
    for _ in range(3):
        d = rng.standard_normal(len(H))
        twice = (cost(truth, 1e-4 * d) + cost(truth, -1e-4 * d)) / 1e-8
        assert d @ H @ d == pytest.approx(twice / 2, rel=1e-5)
    off = moved(truth, 0.05 * rng.standard_normal(len(H)), free)
    _, gradient = refinement.normal_equations(off, data, weights, free)
    h = 1e-6 * np.eye(len(H))
    expected = [(cost(off, -step) - cost(off, step)) / 4e-6 for step in h]
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-6 * np.abs(gradient).max())


def test_refinement_lowers_the_likelihood_of_no_start_and_masks_the_direct_term():
    records = campaign(noise=0.05)
    su, sy = standard_deviations(records)
    data = [spectra([record], su, sy, 12.0) for record in records]
    lines = [spectrum for each in data for spectrum in each]
    plant = unstable_plant()
    start = StateSpace(1.1 * plant.A, plant.B, plant.C, plant.D)
    mask = np.array([[False, False], [False, False], [True, True]])
    refined, _ = refine(start, lines, su, sy, mask)
    np.testing.assert_array_equal(refined.D[:2], 0.0)
    before, after, truth = (
        information_criteria(system, data, su, sy, 2).mean() for system in (start, refined, plant)
    )
    assert after < before
    assert after <= truth + 1e-3  # the maximum is at least as likely as the truth


def test_the_correction_of_the_criterion_is_akaikes_and_more_terms_than_data_are_worth_nothing():
    flown = campaign(records=2, duration=12.0)
    su, sy = standard_deviations(flown)
    data = [spectra([record], su, sy, 8.0) for record in flown]
    plant = unstable_plant()
    N = 2 * sum(each.Y.size for lines in data for each in lines)
    least = plant.nx * (len(su) + len(sy) + sum(map(len, data)))

    def criterion(k):
        return information_criteria(plant, data, su, sy, k - least).mean()

    def correction(k):
        return 2 * k / (N - k - 1)

    for k in (least + 3, N - 2):
        rise = correction(k) - correction(least)
        assert criterion(k) - criterion(least) == pytest.approx(rise, rel=1e-9)
    assert criterion(N - 1) == criterion(N) == np.inf


def test_standard_deviations_of_a_response_are_those_of_its_logarithm():
    # G = c b/(jω - λ): d log G = dλ/(jω - λ) + db/b + dc/c, and dλ alone moves the phase.
    omega, (lam, b, c), errors = np.array([0.3, 2.0, 9.0]), (-2.0, 3.0, 1.5), (0.1, 0.2, 0.3)
    modal = Modal(*(np.array(v, dtype=complex) for v in ([lam], [[b]], [[c]])), np.zeros((1, 1)))
    none, one = np.zeros((0, 2), dtype=int), np.ones(1)
    F = ResponseUncertainty(modal, none, np.diag(errors), one, one).response_factor(omega)
    size, phase = (np.linalg.norm(part, axis=-1) for part in (F.real, F.imag))
    r = errors[0] / (1j * omega - lam)
    expected = np.sqrt(r.real**2 + (errors[1] / b) ** 2 + (errors[2] / c) ** 2)
    np.testing.assert_allclose(size[:, 0, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(phase[:, 0, 0], np.abs(r.imag), rtol=1e-12)
