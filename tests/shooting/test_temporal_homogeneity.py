"""Records that contradict each other by residuals in time: found, and seldom told by chance."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter, lsim
from truths.banked import told
from truths.structures import Banking

from casid import DataWarning, OutputError, Record, output_error
from casid.bounds.trials import aicc
from casid.errors import unasked
from casid.shooting.hausman import Source
from casid.shooting.homogeneity import OPPOSED
from casid.shooting.outlying_records import SELDOM, Records
from casid.shooting.temporal_homogeneity import contradiction

T = np.arange(0, 8, 0.05)


def flown(gains, seed, colour=0.0, lag=0.0, *, alike=False, sizes=()):
    """Records of Lp = -4 and Llat of each, with noise of a colour, measured through a lag [s].

    Of inputs of 0.2 times sizes.
    """
    rng, made = np.random.default_rng(seed), []
    for k, gain in enumerate(gains):
        u = 0.2 * np.sign(np.sin((1.5 + 0.5 * (k // 2) * (not alike)) * T)) * (T > 0.5) * (T < 7)
        u = u * (sizes[k] if sizes else 1)
        system = [[-4.0, 0.0], [1.0, 0.0]], [[gain], [0.0]], np.eye(2), np.zeros((2, 1))
        heard = lsim(([1], [lag, 1]), u, T)[1] if lag else u
        e = lfilter([1], [1, -colour], rng.standard_normal((len(T) + 200, 2)), axis=0)[200:]
        y = lsim(system, heard, T)[1] + e * np.sqrt(1 - colour**2) * [0.03, 0.01]
        made.append(Record(T, u[:, None], y, Banking.inputs, Banking.outputs, f"flight {k}"))
    return made


@pytest.mark.second
@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_a_response_that_depends_on_amplitude_is_told_where_half_are_of_each(colour):
    sizes = [1, 2, 1, 2]
    records = flown([10.0, 8.5] * 2, 1, colour, sizes=sizes)
    fit, (said,) = told(records)
    assert (
        "those of the larger inputs, flight 1, flight 3, and those of the smaller, flight 0, "
        "flight 2 (chi"
    ) in said
    assert "Llat by +" in said
    assert "The response seems to depend on amplitude (ask distortion)" in said
    assert "that of Llat is" in said
    with unasked():
        again, nothing = told(records)
    assert nothing == []
    np.testing.assert_array_equal(again.covariance, fit.covariance)
    assert told(flown([10.0] * 4, 1, colour, sizes=sizes))[1] == []


@pytest.mark.second
def test_errors_are_no_less_than_estimates_scatter_from_record_to_record():
    records = flown([8.0, 10.0, 12.0, 8.5, 10.5, 12.5], 2, alike=True)
    fit, (said,) = told(records)
    assert "but also the others, whichever few are left out" in said
    # Flown alike, each counts the same: the estimate is their mean, its error that of a mean, or
    # what parts of records say.
    ones = [output_error(Banking(), each)["Llat"].value for each in records]
    assert 0.95 < fit["Llat"].std_error / (np.std(ones, ddof=1) / np.sqrt(6)) < 1.5
    assert fit["Llat"].std_error > 3 * fit["Llat"].cramer_rao
    notes = fit.notes
    np.testing.assert_allclose(
        notes.record_scores.sum(axis=0) * np.sqrt(np.diag(notes.cramer_rao)), 0, atol=0.01
    )
    whole = notes.record_information.sum(axis=0) @ notes.cramer_rao
    np.testing.assert_allclose(whole, np.eye(2), atol=1e-6)
    prior, _ = told(records, priors={"Lp": (-4.0, 5.0)})  # which may be what they contradict
    assert prior["Llat"].std_error < 0.9 * fit["Llat"].std_error


@pytest.mark.second
@pytest.mark.parametrize("alike", [True, False])
def test_what_a_structure_misses_in_all_is_no_contradiction(alike):
    assert told(flown([10.0] * 4, 3, lag=0.15, sizes=[1, 2, 1, 2], alike=alike))[1] == []


@pytest.mark.second
def test_two_records_accuse_each_other_unless_what_they_leave_follows_the_inputs():
    (said,) = told(flown([10.0, 12.0], 4, 0.7))[1]
    assert ": flight 0 and flight 1 (chi" in said or ": flight 1 and flight 0 (chi" in said
    assert told(flown([10.0, 12.0], 4, lag=0.15))[1] == []


@pytest.mark.second
def test_samples_that_are_missing_tell_nothing():
    records, rng = flown([10.0, 8.5] * 2, 5, 0.9, sizes=[1, 2, 1, 2]), np.random.default_rng(5)

    def some(each):
        return replace(each, y=np.where(rng.random(each.y.shape) < 0.4, np.nan, each.y))

    assert "those of the larger inputs" in told([some(each) for each in records])[1][0]


def asked(left, slopes, P, F):
    """Arguments of `contradiction`, of inputs that have nothing to do with it."""
    u = np.random.default_rng(0).standard_normal((max(map(len, left)), 1))
    ny = left[0].shape[1]
    names = [f"y{i}" for i in range(ny)]
    records = [Record(np.arange(len(r)) * 0.1, u[: len(r)], r, ["u"], names) for r in left]
    own = [[np.zeros((len(r), ny, 0))] for r in left]
    return records, [-r for r in left], ([[s] for s in slopes], own), P, F, np.zeros(len(P))


def drawn(rng, n, colour, loud, off=0.0, apart=(0.0, 0.0, 0.0)):
    """What is known of least squares of records with noise of a colour, one or all of them off."""
    slopes = [
        lfilter([1], [1, -0.9], rng.standard_normal((k, 2, n)), axis=0) for k in (150, 90, 220)
    ]
    noise = [lfilter([1], [1, -colour], rng.standard_normal((len(s), 2)), axis=0) for s in slopes]
    noise[0] *= loud
    noise[1] = noise[1] + off * slopes[1][:, :, 0]
    noise = [e + each * s[:, :, 0] for e, s, each in zip(noise, slopes, apart, strict=True)]
    noise = [e / np.std(np.concatenate(noise)) for e in noise]
    F = np.sum([np.einsum("nik,nil->kl", s, s) for s in slopes], axis=0)
    P = np.linalg.inv(F)
    step = P @ np.sum(
        [np.einsum("nik,ni->k", s, e) for s, e in zip(slopes, noise, strict=True)], axis=0
    )
    left = [e - s @ step for s, e in zip(slopes, noise, strict=True)]
    return asked(left, slopes, P, F)


@pytest.mark.second
@pytest.mark.parametrize("colour", [0.0, 0.7])
@pytest.mark.parametrize("loud", [1.0, 2.0])
def test_chance_is_told_as_seldom_as_said_and_an_own_parameter_always(colour, loud):
    rng = np.random.default_rng(4)
    assert sum(contradiction(*drawn(rng, 3, colour, loud)) is not None for _ in range(150)) <= 1
    for _ in range(5):
        _, found = contradiction(*drawn(rng, 3, colour, loud, off=2.0))
        assert 1 in found.which


def test_along_what_stays_on_a_break_records_are_not_asked():
    rng = np.random.default_rng(7)
    *made, P, F, slope = drawn(rng, 3, 0.0, 1.0, off=1.0)  # of the first parameter
    assert contradiction(*made, P, F, slope)[1].which == (1,)
    found, _ = contradiction(*made, P, F, np.array([1 / np.sqrt(P[0, 0]), 0, 0]))
    assert found.records.root.shape == (3, 2)  # as though the first were known
    assert np.abs(found.records.root[0]).max() < 1e-9 * np.sqrt(P[0, 0])


def test_residuals_that_are_not_white_are_not_taken_for_such():
    # Of white residuals the same slopes would often contradict each other.
    rng, white = np.random.default_rng(5), 0
    for _ in range(20):
        made = drawn(rng, 3, 0.9, 1.0)
        _, r, (along, _), P, _, _ = made
        root = np.linalg.cholesky(P)
        own = [(s @ root, e) for (s,), e in zip(along, r, strict=True)]
        found = [(np.einsum("nik,ni->k", s, e), np.einsum("nik,nil->kl", s, s)) for s, e in own]
        each = Records([Source(g, F, F) for g, F in found], root).each.values()
        white += min(off.chance for off in each) > SELDOM / len(each)
        assert contradiction(*made) is None
    assert white < 15


def test_errors_by_noise_alone_are_those_of_coloured_noise_with_what_estimates_have_taken_of_it():
    # The mean of a process of first order, three records, one of them off.
    rng, n, colour = np.random.default_rng(6), 4000, 0.7
    noise = [lfilter([1], [1, -colour], rng.standard_normal(n)) for _ in range(3)]
    noise = [e / np.std(np.concatenate(noise)) for e in noise]
    noise[2] = noise[2] + 1.5
    left = [(e - np.mean(noise))[:, None] for e in noise]
    F = np.eye(1) * 3 * n
    _, found = contradiction(*asked(left, [np.ones((n, 1, 1))] * 3, np.linalg.inv(F), F))
    assert found.which == (2,)
    known = (1 + colour) / (1 - colour) / (3 * n)
    np.testing.assert_allclose(found.noise, np.sqrt(known), rtol=0.3)  # of some twenty lines


@pytest.mark.parametrize(("colour", "seen"), [(0.7, 1.0), (0.0, 0.5)])
def test_errors_by_noise_alone_are_those_of_what_is_seen_at_all_frequencies(colour, seen):
    # Slopes that are white meet of a process no more than its variance, wherever its power is.
    rng, n = np.random.default_rng(8), 4000
    there = [rng.random(n) < seen for _ in range(3)]
    slopes = [(rng.standard_normal(n) * on)[:, None, None] for on in there]
    noise = [lfilter([1], [1, -colour], rng.standard_normal(n)) * on for on in there]
    noise = [e / np.sqrt(np.mean(e[on] ** 2)) for e, on in zip(noise, there, strict=True)]
    noise[2] = noise[2] + slopes[2][:, 0, 0]
    F = sum(np.sum(s**2) for s in slopes) * np.eye(1)
    step = sum(s[:, 0, 0] @ e for s, e in zip(slopes, noise, strict=True)) / F[0, 0]
    left = [(e - step * s[:, 0, 0])[:, None] for s, e in zip(slopes, noise, strict=True)]
    _, found = contradiction(*asked(left, slopes, np.linalg.inv(F), F))
    assert found.which == (2,)
    np.testing.assert_allclose(found.noise, 1 / np.sqrt(F[0]), rtol=0.1)


@pytest.mark.parametrize(("off", "which"), [((0.5, -0.5, 0.0), None), ((0.0, 3.0, 0.0), (1,))])
def test_where_residuals_follow_the_inputs_one_record_is_told_and_not_that_all_differ(
    off, which, monkeypatch
):
    made = drawn(np.random.default_rng(10), 3, 0.0, 1.0, apart=off)
    found = contradiction(*made)[1]
    assert (found.any is None) == (which is None)
    missed = [SimpleNamespace(chance=0.0)]
    monkeypatch.setattr("casid.shooting.temporal_homogeneity.followed", lambda *_: missed)
    found = contradiction(*made)
    assert (found and found[1].which) == which
    known, told = contradiction(*made, known=True)  # as a fit beside has found
    assert len(known.records.sources) == 3
    assert (told is None) == (which is None)


@pytest.mark.second
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_beside_a_fit_records_contradict_each_other_if_they_did_there(domain):
    estimator, model = OutputError(domain=domain), Banking()
    odd, alike = (flown([10.0, 10.0, 10.0, last], 1) for last in (12.0, 10.0))
    with pytest.warns(DataWarning, match=OPPOSED):
        wide = estimator.fit(model, odd)
    assert wide.notes.between_records.shape == (2, 2)
    noise = wide.covariance - wide.notes.between_records
    assert noise[1, 1] < wide.covariance[1, 1] / 2  # of Llat
    sound = estimator.fit(model, alike)
    assert sound.notes.between_records.size == 0
    with unasked():
        narrow = estimator.fit(model, odd, near=sound)
        again = estimator.fit(model, odd, near=wide)
        none = estimator.fit(model, alike, near=wide)
    assert narrow.notes.between_records.size == 0
    assert none.notes.between_records.shape == (2, 2)
    size = np.sqrt(np.diag(wide.covariance))
    np.testing.assert_allclose(again.covariance / np.outer(size, size),
                               wide.covariance / np.outer(size, size), atol=0.01)  # fmt: skip
    if domain == "time":  # by the same likelihood; in the other spectra of the fit beside are held
        np.testing.assert_allclose(np.diag(narrow.covariance), np.diag(noise), rtol=0.01)
        assert aicc(narrow, odd) == pytest.approx(aicc(wide, odd), abs=0.1)
