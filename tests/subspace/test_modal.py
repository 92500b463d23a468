import numpy as np
from truths.systems import unstable_plant

from casid.subspace.modal import from_modal, mixed, mixing, schur, to_modal

OMEGA = np.geomspace(0.5, 6.0, 12)


def test_modal_coordinates_are_the_same_system():
    plant = unstable_plant()
    su, sy = np.array([2.0, 0.5]), np.array([1.0, 3.0, 0.2])
    back = from_modal(to_modal(plant, su, sy, plant.D != 0), su, sy, plant)
    np.testing.assert_allclose(back.response(OMEGA), plant.response(OMEGA), rtol=1e-10)


def test_the_matrix_that_mixes_is_what_an_output_sees():
    plant = unstable_plant()
    modal = to_modal(plant, np.ones(plant.nu), np.ones(plant.ny), np.ones(plant.D.shape, bool))
    signals = np.random.default_rng(0).standard_normal((5, plant.nx))
    for o, M in enumerate(mixing(modal)):
        np.testing.assert_allclose(signals @ M, mixed(signals, modal, o, 1), rtol=1e-14)


def test_transients_of_different_size_are_eliminated_alike():
    rng = np.random.default_rng(0)
    J, scale = rng.standard_normal((50, 7)), np.array([1.0, 2e-3, 1e-9, 1, 1, 1, 1])
    left = J[:, 3:] - J[:, :3] @ np.linalg.lstsq(J[:, :3], J[:, 3:])[0]
    found = schur((J * scale).T @ (J * scale), 3)
    np.testing.assert_allclose(found, left.T @ left, rtol=1e-8, atol=1e-8)
