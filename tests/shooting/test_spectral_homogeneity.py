"""Records that contradict each other on the lines of their transforms, and how they scatter."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter, lsim
from scipy.special import ndtri
from scipy.stats import norm, t
from truths.structures import Banking

import casid.shooting.spectral_homogeneity
from casid import DataWarning, Record, output_error
from casid.errors import unasked
from casid.free import free_parameters
from casid.shooting.homogeneity import OPPOSED
from casid.shooting.lines import transformed
from casid.shooting.spectral import SpectralResiduals
from casid.shooting.spectral_homogeneity import _levels, opposed
from casid.shooting.temporal_homogeneity import Transformed

T = np.arange(0, 10, 0.05)
R = np.diag([0.03**2, 0.01**2])


def flown(gains, seed, colour=0.0, lag=0.0, *, alike=False, sizes=()):
    """Records of Lp = -4 and Llat of each, with noise of a colour, measured through a lag [s].

    Of inputs of 0.2 times sizes.
    """
    rng, made = np.random.default_rng(seed), []
    for k, gain in enumerate(gains):
        u = (
            0.2
            * (sizes[k] if sizes else 1)
            * np.sign(np.sin((1.5 + 0.5 * k * (not alike)) * T))
            * (T > 0.5)
            * (T < 9)
        )
        system = [[-4.0, 0.0], [1.0, 0.0]], [[gain], [0.0]], np.eye(2), np.zeros((2, 1))
        y = lsim(system, u, T)[1]
        if lag:
            y = lsim(([1], [lag, 1]), y[:, 0], T)[1][:, None] * [1, 0] + y * [0, 1]
        e = lfilter([1], [1, -colour], rng.standard_normal((len(T) + 200, 2)), axis=0)[200:]
        y = y + e * np.sqrt(1 - colour**2) * [0.03, 0.01]
        made.append(Record(T, u[:, None], y, Banking.inputs, Banking.outputs, f"flight {k}"))
    return made


def told(records, **settings):
    """The fit and what is said of records that contradict each other."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        fit = output_error(Banking(), records, domain="frequency", **settings)
    return fit, [str(each.message) for each in caught if str(each.message).startswith(OPPOSED)]


def at(fit, records):
    """Records against each other at a fit, residuals white."""
    free, lines = free_parameters(fit.model, (), None, None), transformed(records)
    powers = [np.tile(np.diag(R), (len(each.omega), 1)) for each in lines]
    weights = [each.weight[:, None] / power for each, power in zip(lines, powers, strict=True)]
    lam = np.array([fit[name].value for name in fit.free_names])
    residuals = SpectralResiduals(free, lines)(lam, weights)
    P = np.linalg.inv(np.sum([each.F for each in residuals], axis=0))
    return opposed(lines, residuals, powers, P), lines


@pytest.mark.second
def test_scores_lead_to_the_estimate_and_the_residuals_of_each_record_alone():
    records = flown([10.0] * 3, seed=1)
    fit = output_error(Banking(), records, domain="frequency", R=R)
    found, lines = at(fit, records)
    root, own = found.records.root, found.records.sources
    np.testing.assert_allclose(np.sum([each.g for each in own], axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(np.sum([each.F for each in own], axis=0), np.eye(2), atol=1e-9)
    np.testing.assert_allclose(found.inverse @ root, np.eye(2), atol=1e-9)
    for each, r, line, left in zip(own, records, lines, found.left, strict=True):
        alone = output_error(Banking(), r, domain="frequency", R=R)
        step = np.array([alone[name].value - fit[name].value for name in fit.free_names])
        ahead = -root @ np.linalg.solve(each.F, each.g)
        error = np.array([alone[name].cramer_rao for name in fit.free_names])
        np.testing.assert_allclose(ahead / error, step / error, atol=0.1)  # to first order
        free = free_parameters(alone.model, (), None, None)
        lam = np.array([alone[name].value for name in alone.free_names])
        weight = line.weight[:, None] / np.diag(R)
        E = SpectralResiduals(free, [line])(lam, [weight])[0].E
        assert np.abs(left.E - E).max() < 0.02 * np.abs(E).max()


def test_of_records_that_hold_other_bands_noise_is_as_large_as_it_is_in_each():
    """A spectrum that falls, of one size in all but the last, which has four times the power."""
    ends, ratio = (3.0, 12.0, 3.0, 12.0, 6.0), np.zeros(5)
    for seed in range(60):
        rng, lines, left, own = np.random.default_rng(seed), [], [], []
        for duration, end in zip((60, 20, 30, 50, 40), ends, strict=True):
            omega = np.arange(2 * np.pi / duration, end, 2 * np.pi / duration)
            power = (1 + 3 * (end == 6.0)) / (1 + omega**2)[:, None]
            E = np.sqrt(power / 2) * (rng.standard_normal((2, *power.shape)).T @ [1, 1j]).T
            weight, nothing = np.full(len(omega), 2.0), np.zeros((1, 1))
            each = SimpleNamespace(omega=omega, weight=weight, kind=0, Y=E, seen=[True])
            lines.append(each)
            left.append(np.full(E.shape, 2.0))
            own.append((Transformed(E, nothing, nothing, nothing, nothing), power))
        shapes, sizes = _levels(lines, [r for r, _ in own], left, white=False)
        found = zip(shapes, sizes, own, strict=True)
        ratio += [np.median(shape * size / power) / 60 for shape, size, (_, power) in found]
    np.testing.assert_allclose(ratio, 1, atol=0.1)


@pytest.mark.second
def test_a_stick_of_another_gain_is_told_once_and_only_to_who_asks():
    records = flown([10.0, 10.0, 12.0, 10.0], seed=1)
    fit, (said,) = told(records)
    assert ": flight 2 and all others, which agree (chi-square of" in said
    assert "Llat by -" in said
    assert "amplitude" not in said  # all were flown alike
    assert told([each for each in records if each.name != "flight 2"])[1] == []
    with unasked():
        again, nothing = told(records)
    assert nothing == []
    np.testing.assert_array_equal(again.covariance, fit.covariance)


@pytest.mark.second
def test_gains_that_scatter_from_flight_to_flight_are_nobodys_fault_and_widen_errors():
    gains = [8.0, 10.0, 12.0, 8.5, 10.5, 12.5]
    records = flown(gains, seed=2, alike=True)
    fit, (said,) = told(records)
    assert "but also the others, whichever few are left out" in said
    assert "ask distortion" in said
    # Flown alike, each counts the same: the estimate is their mean, its error that of a mean.
    ones = [output_error(Banking(), each, domain="frequency")["Llat"].value for each in records]
    assert fit["Llat"].std_error == pytest.approx(np.std(ones, ddof=1) / np.sqrt(6), rel=0.05)
    assert fit["Llat"].std_error > 3 * fit["Llat"].cramer_rao
    notes = fit.notes
    np.testing.assert_allclose(
        notes.record_scores.sum(axis=0) * np.sqrt(np.diag(notes.cramer_rao)), 0, atol=0.01
    )
    prior, _ = told(records, priors={"Lp": (-4.0, 5.0)})  # which may be what they contradict
    assert not len(prior.notes.record_scores)
    assert prior["Llat"].std_error < fit["Llat"].std_error / 2
    whole = notes.record_information.sum(axis=0) @ notes.cramer_rao
    np.testing.assert_allclose(whole, np.eye(2), atol=1e-6)


@pytest.mark.second
@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_two_records_accuse_each_other_where_their_own_estimates_leave_noise(lag):
    records = flown([10.0, 13.0], seed=3, lag=lag)
    said = told(records)[1]
    assert len(said) == (not lag)
    assert lag or ": flight 0 and flight 1 (chi" in said[0] or ": flight 1 and flight 0" in said[0]
    # A prior may be what one of two contradicts.
    assert lag or told(records, priors={"Lp": (-4.0, 5.0)})[1] == []


@pytest.mark.second
@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_a_response_that_depends_on_amplitude_is_told_where_half_are_of_each(colour):
    sizes = [1, 2, 1, 2, 1, 2]
    records = flown([9.0, 11.0] * 3, seed=12, colour=colour, sizes=sizes)
    fit, (said,) = told(records)
    assert (
        "those of the larger inputs, flight 1, flight 3, flight 5, and those of the smaller, "
        "flight 0, flight 2, flight 4 (chi"
    ) in said
    assert "Llat by -" in said
    assert "The response seems to depend on amplitude (ask distortion)" in said
    ratio = float(said.partition("larger: that of Llat is ")[2].partition(" times")[0])
    assert 1 < ratio <= 1.05 * fit["Llat"].std_error / fit["Llat"].cramer_rao or colour
    assert told(flown([10.0] * 6, seed=12, colour=colour, sizes=sizes))[1] == []


@pytest.mark.second
def test_along_what_stays_on_a_break_records_are_not_asked():
    records = flown([10.0] * 3, seed=13)
    fit = output_error(Banking(), records, domain="frequency", R=R)
    whole, lines = at(fit, records)
    free = free_parameters(fit.model, (), None, None)
    powers = [np.tile(np.diag(R), (len(each.omega), 1)) for each in lines]
    weights = [each.weight[:, None] / power for each, power in zip(lines, powers, strict=True)]
    lam = np.array([fit[name].value for name in fit.free_names])
    residuals = SpectralResiduals(free, lines)(lam, weights)
    P = np.linalg.inv(np.sum([each.F for each in residuals], axis=0))
    slope = np.array([3.0 / np.sqrt(P[0, 0]), 0.0])
    found = opposed(lines, residuals, powers, P, slope)
    # As though the first were known: its row of the root is nothing.
    assert found.records.root.shape == (2, 1)
    assert abs(found.records.root[0]) < 1e-9 * np.sqrt(P[0, 0])
    F = np.linalg.inv(P)
    np.testing.assert_allclose(found.records.root[1] ** 2, 1 / F[1, 1], rtol=1e-9)
    np.testing.assert_allclose(found.inverse @ found.records.root, [[1]], atol=1e-9)
    np.testing.assert_allclose(found.scores[0], whole.scores[0])  # of all, as they are
    assert opposed(lines, residuals, powers, P, 1e-5 * slope).records.root.shape == (2, 2)


@pytest.mark.second
def test_what_noise_does_widens_no_error_and_is_not_told():
    records = flown([10.0] * 3, seed=4)
    fit, said = told(records)
    assert said == []
    assert not len(fit.notes.record_scores)
    np.testing.assert_array_equal(told(records, priors={"Lp": (-6.0, 0.05)})[1], [])


def test_one_record_has_no_other():
    fit, said = told(flown([10.0], seed=5))
    assert said == []
    assert not len(fit.notes.record_scores)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("colour", "lag", "loud"), [(0, 0, 1), (0.9, 0, 1), (0, 0, 3), (0, 0.1, 1)]
)
def test_chance_is_told_as_seldom_as_said(colour, lag, loud):
    wide = 0
    for seed in range(100):
        records = flown([10.0] * 4, (9, seed), colour, lag)
        noise = np.random.default_rng((8, seed)).standard_normal(records[0].y.shape)
        y = records[0].y + np.sqrt(loud**2 - 1) * noise * [0.03, 0.01]
        fit, said = told([replace(records[0], y=y), *records[1:]])
        assert said == []
        wide += len(fit.notes.record_scores) > 0
    assert wide <= (100 if lag else 1)


@pytest.mark.second
def test_spectra_settle_where_directions_of_noise_under_way_come_and_go():
    fit, said = told(flown([10.0] * 4, (9, 1)))  # a ConvergenceError where they are not held
    assert fit.success
    assert said == []


def scatter(records):
    """Covariances of the scores of every record at the estimate of all."""
    fit = output_error(Banking(), records, domain="frequency", R=R)
    return np.array([each.S for each in at(fit, records)[0].records.sources])


def test_of_few_lines_scores_scatter_as_students_t(monkeypatch):
    records = flown([10.0] * 3, seed=7)
    with unasked():
        found = scatter(records)
        monkeypatch.setattr(
            casid.shooting.spectral_homogeneity,
            "stdtrit",
            lambda free, p: np.full(len(free), ndtri(p)),
        )
        normal = scatter(records)
    wider = np.sqrt(np.diagonal(found / normal, axis1=1, axis2=2))
    np.testing.assert_allclose(found, normal * wider[:, :, None] * wider[:, None], rtol=1e-9)
    # By Student's t of no more degrees of freedom than there are numbers on all lines, and of one.
    chance = casid.shooting.spectral_homogeneity.RARELY / len(records) / 2
    least, most = (t.isf(chance, n) / norm.isf(chance) for n in (3 * 2 * len(T), 1))
    assert least < wider.min() <= wider.max() < most
