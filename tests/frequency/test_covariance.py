"""Errors of a frequency response made independent."""

from dataclasses import replace

import numpy as np
import pytest
from truths.systems import OMEGA, unstable_plant

from casid import FrequencyResponse
from casid.frequency import covariance
from casid.frequency.covariance import steadied, whitener

PLANT = unstable_plant()
EVERY = np.ones((3, 2), dtype=bool)


def response(**more):
    G = PLANT.response(OMEGA)
    ones = np.ones(G.shape)
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=0.9 * ones, random_error=0.1 * ones, inputs=PLANT.inputs,
        outputs=PLANT.outputs, input_std=np.ones(2), output_std=np.ones(3), **more,
    )  # fmt: skip


def unit_rows(found, G):
    """Rows of every single point's error, (points, K ny nu)."""
    units = np.eye(G.size).reshape(*G.shape, G.size)
    return found(units)


def test_independent_errors_are_divided_by_their_size(monkeypatch):
    monkeypatch.setattr(covariance, "ALONE", 0.0)
    monkeypatch.setattr(covariance, "ALONG", 0.0)
    measured = response(leakage=np.full((len(OMEGA), 3, 2), 0.2))
    W = unit_rows(whitener(measured, EVERY), measured.G)
    expected = 1 / (np.hypot(0.1, 0.2) * np.abs(measured.G.ravel()))
    np.testing.assert_allclose(np.sort(np.abs(W).max(axis=0)), np.sort(expected), rtol=1e-9)
    assert np.count_nonzero(np.abs(W) > 1e-9) == W.shape[0] == measured.G.size


def test_correlated_errors_become_independent(monkeypatch):
    # Errors with just the covariance that is stated: of one frequency, and along frequency.
    monkeypatch.setattr(covariance, "ALONE", 1e-9)
    monkeypatch.setattr(covariance, "ALONG", 1e-9)
    K = len(OMEGA)
    S = np.array([[1, 0.6j, 0], [-0.6j, 1, 0.3], [0, 0.3, 1]])
    Q = np.array([[1, 0.5 + 0.2j], [0.5 - 0.2j, 1]])
    width = 0.1 * OMEGA
    measured = response(
        resolution=np.tile(width[:, None, None], (1, 3, 2)),
        output_correlation=np.tile(S, (K, 1, 1)), input_correlation=np.tile(Q, (K, 1, 1)),
    )  # fmt: skip
    fine = np.linspace(-2, 12, 4000)  # spectral windows, drawn: their overlap is the correlation
    windows = np.exp(-(((fine - OMEGA[:, None]) / width[:, None]) ** 2) / 2)
    windows /= np.linalg.norm(windows, axis=1)[:, None]
    size = 0.1 * np.abs(measured.G).reshape(K, 6)
    root = size[:, :, None] * np.linalg.cholesky(np.kron(S, Q))
    C = np.einsum("kpa,kl,lqa->kplq", root, windows @ windows.T, root.conj()).reshape(6 * K, -1)
    W = unit_rows(whitener(measured, EVERY), measured.G)
    np.testing.assert_allclose(W @ C @ W.conj().T, np.eye(6 * K), atol=1e-5)
    # Real numbers that depend on the errors, Re Σ c ΔG: variance c C cᴴ.
    rng = np.random.default_rng(0)
    gains = rng.standard_normal((6 * K, 4)) + 1j * rng.standard_normal((6 * K, 4))
    spread = whitener(measured, EVERY).spread(gains.reshape(K, 3, 2, 4))
    np.testing.assert_allclose(spread, (gains.T @ C @ gains.conj()).real, rtol=1e-5, atol=1e-4)


def test_so_many_independent_points_have_a_mean_power_that_scatters_as_theirs():
    K = len(OMEGA)
    S, Q = np.array([[1, 0.6j, 0], [-0.6j, 1, 0.3], [0, 0.3, 1]]), np.array([[1, 0.5], [0.5, 1]])
    assert whitener(response(), EVERY).independent == pytest.approx(6 * K)
    alike = {
        "output_correlation": np.tile(S, (K, 1, 1)),
        "input_correlation": np.tile(Q, (K, 1, 1)),
    }
    measured = response(resolution=np.full((K, 3, 2), 0.2), **alike)
    found = whitener(measured, EVERY)
    rho = np.exp(-((OMEGA - OMEGA[:, None]) ** 2) / (4 * 0.2**2)) + 1e-9 * np.eye(K)
    L = np.kron(np.linalg.cholesky(rho), np.linalg.cholesky(np.kron(S, Q)))
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((2, len(L), 4000))
    power = np.abs(L @ (noise[0] + 1j * noise[1])) ** 2 / 2
    assert found.independent == pytest.approx(1 / np.var(power.mean(axis=0)), rel=0.25)
    np.testing.assert_allclose(found.std, 0.1 * np.abs(measured.G))


def test_a_point_that_came_out_sure_by_chance_counts_no_more_than_its_neighbours():
    # By hand: all points alike but one, whose neighbours' weights fall off over 0.7 nepers.
    flat = np.ones((len(OMEGA), 3, 2), dtype=complex)
    error = np.full(flat.shape, 0.1)
    error[10, 1, 0] = 0.01
    own = np.exp(-(((np.log(OMEGA) - np.log(OMEGA[10])) / 0.7) ** 2) / 2)
    expected = np.sqrt(1 - 0.99 / own.sum())  # of the others' error
    estimated = replace(response(), G=flat, random_error=error, coherence=np.full(flat.shape, 0.9))
    steady = weights(estimated)
    np.testing.assert_allclose(steady[10, 1, 0], steady[0, 1, 0] / expected, rtol=1e-6)
    np.testing.assert_allclose(np.delete(steady, 10, axis=0), steady[0, 0, 0], rtol=1e-6)
    # What is given as a table, without coherence, is believed.
    given = weights(replace(estimated, coherence=np.ones(flat.shape)))
    np.testing.assert_allclose(given[10, 1, 0], 10 * given[0, 1, 0], rtol=1e-6)


def test_an_error_that_neighbours_share_stays_what_it_was():
    # Noise and inputs alike over frequency, whatever the response does; or one share of a power.
    n = np.full((len(OMEGA), 3, 2), 0.9)
    falling = np.full(n.shape, 3.0) * OMEGA[:, None, None] ** -2.0
    flat, plant = np.full(n.shape, 0.1), np.abs(response().G)
    for size, error in ((plant, 0.1 / plant), (falling, flat)):
        own = replace(response(), G=size.astype(complex), random_error=error, coherence=n)
        np.testing.assert_allclose(weights(own), 1 / (error * size), rtol=1e-9)
    # One share of a response with resonances, which is no power between the points beside.
    found = weights(replace(response(), random_error=flat, coherence=n)) * flat * plant
    assert np.all((found > 0.8) & (found < 1 + 1e-9))
    assert np.median(found) > 0.99


def test_points_that_came_out_small_by_chance_count_no_more():
    # The gain of a response of which every point errs by a quarter of the truth, as an estimate
    # states that: by the error over what was measured.
    rng, truth = np.random.default_rng(4), response().G
    found = []
    for _ in range(100):
        error = 0.25 * np.abs(truth)
        noise = rng.standard_normal((2, *truth.shape)) * error
        G = truth + noise[0] + 1j * noise[1]
        seen = replace(response(), G=G, random_error=error / np.abs(G), coherence=0.9 + 0 * error)
        w = weights(seen) ** 2
        found.append(np.sum(w * (G * truth.conj()).real) / np.sum(w * np.abs(truth) ** 2))
    assert np.mean(found) == pytest.approx(
        1.0, abs=0.4 * np.std(found)
    )  # of a single one's scatter


def weights(measured):
    """What every point's error is multiplied by, (K, ny, nu), without neighbours."""
    found = whitener(steadied(measured), EVERY)
    return np.abs(np.diagonal(found.across, axis1=1, axis2=2)).reshape(measured.G.shape)


def test_points_without_an_error_flagged_or_not_wanted_do_not_count():
    G = PLANT.response(OMEGA)
    error = np.full(G.shape, 0.1)
    error[3, 1, 0] = np.nan
    measured = replace(response(flags={"distrusted": (0, 5)}), random_error=error)
    wanted = EVERY.copy()
    wanted[2] = False
    found = whitener(measured, wanted)
    assert not found.used[[0, 5]].any()
    assert not found.used[3, 1, 0]
    assert not found.used[:, 2].any()
    none = np.where(found.used[..., None], 0.0, 1.0)
    assert found.spread(none) == 0.0
    assert found.used.sum() == 4 * (len(OMEGA) - 2) - 1 == len(unit_rows(found, G))


def test_a_response_without_errors_is_refused():
    unknown = replace(response(), random_error=np.full((len(OMEGA), 3, 2), np.nan))
    with pytest.raises(ValueError, match="states no error at any usable point"):
        whitener(unknown, EVERY)


def test_errors_along_frequency_keep_their_size():
    root = covariance._root(OMEGA, 0.15 * OMEGA)
    C = np.linalg.inv(root) @ np.linalg.inv(root).T
    np.testing.assert_allclose(np.diag(C), 1.0, rtol=1e-9)
    assert np.all(np.diag(C, 1) > 0.1)
    np.testing.assert_allclose(covariance._root(OMEGA, 0 * OMEGA), np.eye(len(OMEGA)), atol=1e-12)


@pytest.mark.parametrize("bends", [0, 2, 10])
def test_a_finer_grid_tells_no_more_than_the_windows_do(bends):
    def told(points):
        omega = np.geomspace(0.5, 12.0, points)
        root = covariance._root(omega, np.maximum(0.12, 0.06 * omega))
        return np.sum((root @ np.cos(bends * np.log(omega))) ** 2)

    assert told(240) == pytest.approx(told(40), rel=0.05)
