import numpy as np
from truths.systems import campaign, unstable_plant

from casid.records import standard_deviations
from casid.subspace.fourier import spectra
from casid.subspace.likelihood import all_factors, factors, forced
from casid.subspace.modal import mixing, pair, to_modal
from casid.subspace.refinement import residual_powers


def test_records_of_one_length_and_sampling_share_their_pole_factors():
    long, short = campaign(records=2), campaign(records=2, duration=12.0)
    su, sy = standard_deviations(long)
    data, plant = spectra([*long, *short], su, sy, 12.0), unstable_plant()
    modal = to_modal(plant, su, sy, plant.D != 0)
    found = list(all_factors(modal, data))
    assert found[0] is found[1] is not found[2] is found[3]
    for shared, spectrum in zip(found, data, strict=True):
        np.testing.assert_array_equal(shared.slope, factors(modal, spectrum).slope)


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
    f = factors(modal, data[0])
    E = forced(modal, data[0], f)
    shared = pair(f.transient, f.transient_c, modal.real)
    P = np.vstack(shared @ mixing(modal.C, modal.real))
    both = [np.concatenate([v.real, v.imag]) for v in (P, E.T.ravel())]
    delta = np.linalg.lstsq(*both, rcond=None)[0]
    left = (E.T.ravel() - P @ delta).reshape(E.T.shape).T
    np.testing.assert_allclose(power, np.abs(left) ** 2, rtol=1e-8, atol=1e-12 * power.max())
