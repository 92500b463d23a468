from dataclasses import replace

import numpy as np
from truths.systems import campaign, unstable_plant

from casid.records import standard_deviations
from casid.subspace.fourier import spectra
from casid.subspace.likelihood import parts
from casid.subspace.modal import (
    Modal,
    descend,
    from_modal,
    gauge,
    mixing,
    moved,
    pair,
    schur,
    tangents,
    to_modal,
)
from casid.subspace.pooled_spectra import alike
from casid.subspace.slopes import linearised

OMEGA = np.geomspace(0.5, 6.0, 12)


def test_modal_coordinates_are_the_same_system():
    plant = unstable_plant()
    su, sy = np.array([2.0, 0.5]), np.array([1.0, 3.0, 0.2])
    back = from_modal(to_modal(plant, su, sy, plant.D != 0), su, sy, plant)
    np.testing.assert_allclose(back.response(OMEGA), plant.response(OMEGA), rtol=1e-10)


def test_what_an_output_sees_of_modes_is_their_signals_times_its_row_of_c():
    plant, rng = unstable_plant(), np.random.default_rng(0)
    modal = to_modal(plant, np.ones(plant.nu), np.ones(plant.ny), np.ones(plant.D.shape, bool))
    phi, other = rng.standard_normal((2, 5, len(modal.lam), 2)) @ [1, 1j]
    other[:, modal.real] = 0
    for c, M in zip(modal.C, mixing(modal.C, modal.real), strict=True):
        expected = pair(c * phi, c.conj() * other, modal.real)
        np.testing.assert_allclose(pair(phi, other, modal.real) @ M, expected, atol=1e-14)


def test_transients_of_different_size_are_eliminated_alike():
    rng = np.random.default_rng(0)
    J, scale = rng.standard_normal((50, 7)), np.array([1.0, 2e-3, 1e-9, 1, 1, 1, 1])
    left = J[:, 3:] - J[:, :3] @ np.linalg.lstsq(J[:, :3], J[:, 3:])[0]
    found = schur((J * scale).T @ (J * scale), 3)
    np.testing.assert_allclose(found, left.T @ left, rtol=1e-8, atol=1e-8)


def test_along_the_gauge_no_response_changes():
    plant = unstable_plant()
    modal = to_modal(plant, np.ones(plant.nu), np.ones(plant.ny), np.zeros(plant.D.shape, bool))
    size = plant.nx * (1 + plant.nu + plant.ny)
    directions = gauge(modal, size)
    assert np.linalg.matrix_rank(directions) == plant.nx

    def response(step):
        model = moved(modal, step, np.zeros((0, 2), dtype=int))
        return from_modal(model, np.ones(plant.nu), np.ones(plant.ny), plant).response(OMEGA)

    for direction in directions.T:
        slope = (response(1e-4 * direction) - response(-1e-4 * direction)) / 2e-4
        assert np.abs(slope).max() < 1e-9 * np.abs(response(0 * direction)).max()


def test_a_descent_finds_the_system_whose_response_is_given():
    truth = Modal(*(np.array(x) for x in ([-0.5 + 2j], [[1.0 + 0.5j]], [[0.7 - 0.2j]], [[0.3]])))
    start = Modal(*(np.array(x) for x in ([-0.7 + 1.8j], [[0.8 + 0.3j]], [[0.9 + 0j]], [[0.1]])))
    free, s = np.array([[0, 0]]), 1j * np.geomspace(0.2, 8.0, 40)

    def response(modal):
        b, c, lam = modal.B[0, 0], modal.C[0, 0], modal.lam[0]
        G = c * b / (s - lam) + np.conj(c * b) / (s - np.conj(lam)) + modal.D[0, 0]
        return np.concatenate([G.real, G.imag])

    def residuals(modal):
        return response(modal) - response(truth)

    def normal(modal):
        steps = 1e-6 * np.eye(7)
        J = [residuals(moved(modal, h, free)) - residuals(moved(modal, -h, free)) for h in steps]
        J = np.array(J) / 2e-6
        return J @ J.T, -J @ residuals(modal)

    for begin in (start, truth):  # of which nothing is left to descend from
        found = descend(
            begin, cost=lambda m: float(np.sum(residuals(m) ** 2)), normal=normal, tidy=lambda m: m,
            free=free, steps=50, settled=1e-6,
        )  # fmt: skip
        np.testing.assert_allclose(response(found), response(truth), atol=1e-6)


def test_a_transient_of_more_states_than_lines_explains_all_of_them():
    # As between two gaps: one line of one output, five states.
    records, plant = campaign(records=1), unstable_plant()
    su, sy = standard_deviations(records)
    (whole,) = spectra(records, su, sy, 12.0)
    one = replace(whole, omega=whole.omega[:1], U=whole.U[:1], Y=whole.Y[:1, :1], h=None)
    modal = to_modal(plant, su, sy, plant.D != 0)
    alone = Modal(modal.lam, modal.B, modal.C[:1], modal.D[:1])
    w, free = np.ones((1, 1)), np.zeros((0, 2), dtype=int)
    ((E, basis),) = linearised(alone, parts(alone, alike([one], [w])))
    near = tangents(alone, E, basis, w, free)
    np.testing.assert_allclose(near.e, 0.0, atol=1e-12)
    (S,) = near.products(np.eye(2)[None], [0], [0])
    np.testing.assert_allclose(S[5:], 0.0, atol=1e-9)
