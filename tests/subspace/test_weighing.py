"""Residual spectra against the window's closed form and a sum over all lines."""

import numpy as np
from truths.systems import campaign

from casid.records import standard_deviations
from casid.subspace.fourier import spectra
from casid.subspace.weighing import WIDTH, known_weights, lines_near, smoothed


def test_a_smoothed_spectrum_is_the_mean_of_all_lines_weighed_by_their_distance():
    rng = np.random.default_rng(3)
    omega = np.log(np.linspace(0.3, 20.0, 400))
    power = rng.exponential(size=(400, 2)) * np.exp(omega)[:, None]
    at = np.log(np.geomspace(0.5, 15.0, 9))
    weight = np.exp(-0.5 * ((at[:, None] - omega) / WIDTH) ** 2)
    expected = weight @ power / weight.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(smoothed(at, omega, power), expected, rtol=2e-3)


def test_weights_of_many_lines_are_those_of_a_known_spectrum():
    record = campaign(records=1, duration=200.0)[0]
    su, sy = standard_deviations([record])
    data = spectra([record], su, sy, 20.0)
    (one,) = [known_weights([lines], [np.ones((len(lines.omega), 3))])[0] for lines in data[:1]]
    spacing = np.diff(data[0].omega)[0]
    n = 2 * np.sqrt(np.pi) * 0.35 * data[0].omega / spacing  # lines in a Gaussian window over log ω
    inside = (data[0].omega > 3) & (data[0].omega < 5)
    expected = np.sqrt((n - 1) / (n + 1))[inside]
    np.testing.assert_allclose(one[inside, 0], expected, rtol=0.01)


def test_lines_near_a_frequency_are_those_that_smoothed_power_scatters_by():
    # The mean of n powers of complex noise has a variance of 1/n.
    rng, seconds = np.random.default_rng(4), (40.0, 25.0)
    omega = np.concatenate([2 * np.pi / T * np.arange(1, int(3 * T)) for T in seconds])
    at = np.array([1.0, 4.0])
    drawn = smoothed(np.log(at), np.log(omega), rng.exponential(size=(len(omega), 4000)))
    np.testing.assert_allclose(1 / drawn.var(axis=1), lines_near(at, sum(seconds)), rtol=0.08)


def test_spectra_that_share_weights_go_on_sharing_them_and_no_others_do():
    records = [*campaign(records=3, duration=8.0), *campaign(records=1, duration=11.0)]
    su, sy = standard_deviations(records)
    data = spectra(records, su, sy, 12.0)
    one, other = (scale * np.ones((len(data[0].omega), 3)) for scale in (1.0, 2.0))
    weights = [one, one, other, np.ones((len(data[3].omega), 3))]
    found = known_weights(data, weights)
    assert found[0] is found[1]
    np.testing.assert_allclose(found[2], 2 * found[0])
    assert len(found[3]) == len(data[3].omega)
