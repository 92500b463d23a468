"""Bands of a fit: derivatives by hand, and the scatter of models drawn from its errors."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from truths.closed_roll import Roll as ClosedRoll
from truths.closed_roll import noisy
from truths.shown import values

from casid import (
    DataWarning,
    Fit,
    Model,
    Record,
    Rows,
    Scalar,
    match,
    mode_bands,
    output_error,
    parameter,
    response_band,
    sample_models,
)
from casid.bands import ResponseBand
from casid.estimates import parameter_table
from casid.free import free_parameters

OMEGA = np.geomspace(0.5, 10.0, 12)


def covariance(fit):
    """Lp and Llat, in that order."""
    order = [fit.free_names.index(name) for name in ("Lp", "Llat")]
    return fit.covariance[np.ix_(order, order)]


def test_the_band_of_a_first_order_lag_is_that_of_its_derivatives_by_hand():
    # ln G = ln Llat - ln(jω - Lp): its derivatives are 1/(jω - Lp) by Lp and 1/Llat by Llat.
    fit = values()["Fit"]
    J = np.stack([1 / (1j * OMEGA - fit["Lp"].value), 0 * OMEGA + 1 / fit["Llat"].value], axis=-1)
    found, C = response_band(fit, OMEGA), covariance(fit)
    for std, part in ((found.magnitude_std, J.real), (found.phase_std, J.imag)):
        by_hand = np.sqrt(np.einsum("ki,ij,kj->k", part, C, part))
        np.testing.assert_allclose(std[:, 0, 0], by_hand, rtol=1e-6)
    low, high = found.magnitude()
    np.testing.assert_allclose(np.log(high / low), 2 * 1.959964 * found.magnitude_std, rtol=1e-6)
    assert (np.diff(found.phase(), axis=0) > 0).all()


class Apart(Model):
    """p' = Lp p + Llat lat, and r' = Nr r + 2 ped: two inputs that move one output each."""

    states, inputs, outputs = ("p", "r"), ("lat", "ped"), ("p", "r")
    Lp: Scalar = parameter(default=-2.0, lower=-9.0, upper=0.0, unit="1/s")
    Llat: Scalar = parameter(default=4.0, lower=0.0, upper=50.0, unit="1/s^2")
    Nr: Scalar = parameter(default=-1.0, lower=-9.0, upper=0.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.Lp, 0], [0, self.Nr]]

    def B(self) -> Rows:
        return [[self.Llat, 0], [0, 2.0]]


def test_where_there_is_no_path_there_is_no_band():
    t = 0.05 * np.arange(300)
    u = 0.1 * np.sign(np.stack([np.sin(1.1 * t), np.sin(0.7 * t + 1)], axis=1))
    noise = 0.01 * np.random.default_rng(4).standard_normal((300, 2))
    y = Apart().system().simulate(t, u) + noise
    fit = output_error(Apart(), [Record(t, u, y, Apart.inputs, Apart.outputs, "both")])
    found, error = response_band(fit, OMEGA), fit["Nr"].std_error
    by_hand = error * np.abs(np.real(1 / (1j * OMEGA - fit["Nr"].value)))
    np.testing.assert_allclose(found.magnitude_std[:, 1, 1], by_hand, rtol=1e-5)
    assert not found.magnitude_std[:, [0, 1], [1, 0]].any()


def test_the_band_of_a_real_pole_is_the_error_of_its_parameter():
    fit = values()["Fit"]
    (only,) = mode_bands(fit)
    assert only.mode.pole == pytest.approx(fit["Lp"].value)
    assert only.real_std == pytest.approx(fit["Lp"].std_error, rel=1e-6)
    assert (only.imag_std, only.damping_std) == (0, 0)


class Spring(Model):
    """Bank angle from the stick, with a stiffness: poles of s² - Lp s - Lphi."""

    states, inputs, outputs = ("p", "phi"), ("lat",), ("phi",)

    Lp: Scalar = parameter(default=-2.0, lower=-20.0, upper=0.0, unit="1/s")
    Lphi: Scalar = parameter(default=-1.0, lower=-20.0, upper=0.0, unit="1/s^2")

    def A(self) -> Rows:
        return [[self.Lp, self.Lphi], [1, 0]]

    def B(self) -> Rows:
        return [[4.0], [0]]


def fitted(model, C, other="Lphi"):
    """A fit of a structure's own values with a given covariance of all of its parameters."""
    free = free_parameters(model)
    table = parameter_table(free, model.vector(), np.zeros(len(C)))
    return Fit(
        model=model, parameters=table, cost=0.0, status="solved", success=True, iterations=1,
        seconds=0.0, method="test", notes=None, covariance=np.array(C),
        free_names=("Lp", other),
    )  # fmt: skip


@pytest.mark.parametrize("Lphi", [-0.9999, -0.98, -1.03])
def test_poles_that_may_be_a_pair_or_both_real_have_the_scatter_of_their_own_roots(Lphi):
    C = np.array([[0.03, 0.01], [0.01, 0.02]])
    found = mode_bands(fitted(Spring(Lphi=Lphi), C))
    # By the quadratic formula; of roots that are real while the estimate is a pair both count.
    Lp, stiff = np.random.default_rng(8).multivariate_normal([-2.0, Lphi], C, 100_000).T
    turn = np.sqrt((Lp / 2) ** 2 + stiff + 0j)
    roots = np.sort_complex(np.array([Lp / 2 - turn, Lp / 2 + turn]).T).T
    for band in found:
        own = roots if band.mode.pole.imag else roots[int(band.mode.pole.real > -1)][None]
        imag, size = np.abs(own.imag), np.abs(own)
        off = (own.real - band.mode.pole.real, imag - band.mode.pole.imag)
        off += (size - band.mode.frequency, -own.real / size - band.mode.damping)
        by_hand = [
            max(np.sqrt(np.mean(each**2)), np.abs(np.quantile(each, [0.025, 0.975])).max() / 1.96)
            for each in off
        ]
        stated = band.real_std, band.imag_std, band.frequency_std, band.damping_std
        np.testing.assert_allclose(stated, by_hand, rtol=0.08)  # of 1000 draws, 3 deviations
        assert f"± {band.imag_std:.2g})j" in band.headline()


@pytest.mark.campaign
def test_errors_of_a_double_pole_hold_it():
    # Estimates of s² - Lp s - Lphi about two poles at -1, whose errors are known.
    C = np.array([[0.0016, 0.0], [0.0, 0.01]])
    held = []
    for Lp, Lphi in np.random.default_rng(1).multivariate_normal([-2.0, -1.0], C, 150):
        for band in mode_bands(fitted(Spring(Lp=float(Lp), Lphi=float(Lphi)), C)):
            held += [abs(band.mode.pole.real + 1) < 1.96 * band.real_std]
    assert 0.9 < np.mean(held) < 0.98


def test_real_poles_that_only_pass_each_other_are_as_known_as_their_parameters():
    class Two(Model):
        states, inputs, outputs = ("p", "r"), ("lat",), ("p", "r")

        Lp: Scalar = parameter(default=-2.0, lower=-20.0, upper=0.0, unit="1/s")
        Nr: Scalar = parameter(default=-2.05, lower=-20.0, upper=0.0, unit="1/s")

        def A(self) -> Rows:
            return [[self.Lp, 0], [0, self.Nr]]

        def B(self) -> Rows:
            return [[4.0], [1.0]]

    found = mode_bands(fitted(Two(), np.diag([0.01, 0.01]), "Nr"))
    assert [each.imag_std for each in found] == [0, 0]
    np.testing.assert_allclose([each.real_std for each in found], 0.1, rtol=1e-6)
    apart = mode_bands(fitted(Two(Nr=-4.0), np.diag([0.01, 0.04]), "Nr"))
    np.testing.assert_allclose([each.real_std for each in apart], [0.1, 0.2], rtol=1e-6)


@pytest.fixture(scope="module")
def rolling():
    """Seven parameters, an unstable pair, a delay."""
    return output_error(ClosedRoll(), noisy(seed=5))


@pytest.mark.second
def test_bands_are_the_scatter_of_models_drawn_from_the_errors(rolling):
    # 600 draws: their standard deviation is known to 3 %, and what is not linear adds little.
    drawn = sample_models(rolling, 600, seed=1)
    pair = max(mode_bands(rolling), key=lambda each: each.mode.pole.imag)
    poles = np.array([m.system().poles()[np.argmax(m.system().poles().imag)] for m in drawn])
    assert pair.real_std == pytest.approx(poles.real.std(), rel=0.12)
    assert pair.imag_std == pytest.approx(poles.imag.std(), rel=0.12)
    size = np.log(np.abs([m.system().response(OMEGA)[:, 1, 0] for m in drawn]))
    found = response_band(rolling, OMEGA).magnitude_std[:, 1, 0]
    np.testing.assert_allclose(found, size.std(axis=0), rtol=0.12)


def test_a_parameter_that_nothing_determines_is_told_where_its_error_is_missing():
    fit = values()["Fit"]
    k = fit.free_names.index("Llat")
    C = fit.covariance.copy()
    C[k], C[:, k] = np.nan, np.nan
    C[k, k] = np.inf
    with pytest.warns(DataWarning, match="do not determine Llat, which count as known here"):
        band = response_band(replace(fit, covariance=C), OMEGA)
    alone = np.abs((1 / (1j * OMEGA - fit["Lp"].value)).real) * fit["Lp"].std_error
    np.testing.assert_allclose(band.magnitude_std[:, 0, 0], alone, rtol=1e-6)


def test_what_makes_no_sense_is_refused():
    fit = values()["Fit"]
    with pytest.raises(ValueError, match="level=95: expected a share"):
        response_band(fit, OMEGA, level=95)
    with pytest.raises(ValueError, match="frequencies above 0"):
        response_band(fit, [0.0, 1.0])
    with pytest.raises(ValueError, match="count=0"):
        sample_models(fit, 0)
    bare = match(type(fit.model)(), fit.model.system())
    with pytest.raises(ValueError, match="no covariance: take that of output_error"):
        mode_bands(replace(bare, covariance=None))


def test_what_is_missed_widens_a_band_evenly_and_never_below_zero():
    one = np.ones((2, 1, 1))
    G, level = np.array([3 + 4j, 2j])[:, None, None], 0.95
    plain = ResponseBand(
        omega=np.array([1.0, 2.0]), G=G, magnitude_std=0.1 * one, phase_std=0.1 * one, level=level,
        inputs=("u",), outputs=("y",),
    )  # fmt: skip
    z = scipy.stats.norm.ppf(0.975)
    sizes = np.abs(G) * np.exp(np.array([-0.1 * z, 0.1 * z]))[:, None, None, None]
    np.testing.assert_allclose(plain.magnitude(), sizes)
    missed = np.array([0.2, 2.0])[:, None, None]  # of both parts together: half its power of each
    low, high = replace(plain, missed=missed).magnitude()
    half = z * np.sqrt(0.1**2 + missed**2 / 2)
    np.testing.assert_allclose(high, np.abs(G) * (1 + half))
    np.testing.assert_allclose(low, np.abs(G) * np.maximum(1 - half, 0))
