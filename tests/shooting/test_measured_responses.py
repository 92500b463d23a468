"""Measured responses in the likelihood of records, in both domains."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from truths.closed_roll import NAMES, TRUTH, campaign, off

from casid import (
    DataWarning,
    FrequencyResponse,
    Model,
    OutputError,
    Record,
    Rows,
    Scalar,
    frequency_response,
    merge_responses,
    monte_carlo,
    output_error,
    parameter,
)
from casid.shooting.measured_responses import check_responses

OMEGA = np.geomspace(0.5, 10.0, 20)
RECORDS = campaign(1, 2)


def measured(share=0.03, seed=0, **more):
    """The truth's response with independent relative errors."""
    rng, G = np.random.default_rng(seed), TRUTH.system().response(OMEGA)
    noise = rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)
    ones = np.ones(G.shape)
    return FrequencyResponse(
        omega=OMEGA, G=G * (1 + share * noise), coherence=ones, random_error=share * ones,
        inputs=TRUTH.inputs, outputs=TRUTH.outputs, input_std=np.ones(2), output_std=np.ones(3),
        **more,
    )  # fmt: skip


def evidence(responses):
    return OutputError(responses=responses).free(off()).evidence


@pytest.mark.parametrize("coherence", [1.0, 0.8])  # stated none, or some
def test_derivatives_agree_with_differences(coherence):
    response = replace(measured(), coherence=np.full((20, 3, 2), coherence))
    found, at = evidence([response]), off().vector()
    _, J = found.residuals(at)
    for k in range(len(at)):
        step = 1e-6 * np.eye(len(at))[k]
        numeric = (found.residuals(at + step)[0] - found.residuals(at - step)[0]) / 2e-6
        np.testing.assert_allclose(J[:, k], numeric, atol=1e-6 * np.abs(J[:, k]).max())


def test_residuals_are_of_unit_variance_at_the_truth():
    r = np.concatenate(
        [evidence([measured(seed=k)]).residuals(TRUTH.vector())[0] for k in range(9)]
    )
    # p and phi do not see the lateral force, ay does not see the pedals: all pairs are there still.
    assert len(r) == 9 * 2 * 20 * 6
    assert np.mean(r**2) == pytest.approx(1, abs=4 * np.sqrt(2 / len(r)))


@pytest.mark.second
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_the_information_of_both_adds_up(domain):
    plain = output_error(TRUTH, RECORDS, domain=domain, R=np.diag([0.05, 0.01, 0.01]) ** 2)
    joint = output_error(
        off(), RECORDS, domain=domain, R=np.diag([0.05, 0.01, 0.01]) ** 2, responses=measured()
    )
    _, J = evidence([measured()]).residuals(joint.model.vector())
    both = np.linalg.inv(plain.notes.cramer_rao) + J.T @ J
    stated = joint.notes.cramer_rao
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(both))), np.sqrt(np.diag(stated)),
                               rtol=0.03)  # fmt: skip
    z = [(joint[name].value - getattr(TRUTH, name)) / joint[name].cramer_rao for name in NAMES]
    assert np.sqrt(np.mean(np.square(z))) < 2
    assert joint.cost > plain.cost + 60  # half a unit for each of 240 residuals, more or less


@pytest.mark.second
def test_the_same_record_is_refused_in_both_forms(tmp_path):
    response = frequency_response(campaign(3, 4), omega=np.geomspace(2.5, 9.0, 8))
    place = tmp_path / "response.json"
    response.save(place)
    K = len(response.omega)  # beside those of a tool that tells no flights
    other = FrequencyResponse(
        omega=response.omega, G=np.ones((K, 1, 1)), coherence=np.ones((K, 1, 1)),
        random_error=np.ones((K, 1, 1)), inputs=("col",), outputs=("psi",), input_std=np.ones(1),
        output_std=np.ones(1),
    )  # fmt: skip
    merged = merge_responses([other, response])
    assert merged.records == response.records
    merged.save(tmp_path / "merged.json")
    loaded = [FrequencyResponse.load(tmp_path / name) for name in ("response.json", "merged.json")]
    for each in (response, merged, *loaded):
        with pytest.raises(ValueError, match="enters as a time history and, as 'record 0'"):
            output_error(TRUTH, campaign(3, 1)[0].decimate(2), responses=each)
    record = campaign(3, 1)[0]
    level = replace(record, y=record.y - record.y.mean(axis=0)).cut(1.0, record.t[-1])
    with pytest.raises(ValueError, match="enters as a time history and, as 'record 0'"):
        output_error(TRUTH, level, responses=response)
    for twice in ([response, response], [response, merged]):
        with pytest.raises(ValueError, match="two responses are one flight"):
            output_error(TRUTH, RECORDS, responses=twice)


def test_what_is_no_response_of_the_structure_is_refused():
    with pytest.raises(ValueError, match="responses = a StateSpace, expected FrequencyResponse"):
        output_error(TRUTH, RECORDS, responses=TRUTH.system())
    with pytest.raises(ValueError, match="no pair of"):
        output_error(TRUTH, RECORDS, responses=replace(measured(), outputs=("a", "b", "c")))
    with pytest.raises(ValueError, match="no pair of"):
        output_error(TRUTH, RECORDS, responses=replace(measured(), inputs=("a", "b")))


def test_responses_that_are_worse_than_stated_widen_the_errors():
    stated = measured()
    worse = replace(stated, random_error=stated.random_error / 5)
    found, at = evidence([worse]), TRUTH.vector()
    r, J = found.residuals(at)
    np.testing.assert_allclose(found.scatter(at), np.mean(r**2) * J.T @ J)
    assert np.mean(r**2) == pytest.approx(25, rel=0.3)


@pytest.mark.campaign
def test_a_joint_estimate_is_as_good_as_its_information_says():
    z = []
    for seed in range(16):
        fit = output_error(TRUTH, campaign(seed, 2), responses=measured(seed=seed))
        z.append(
            [(fit[name].value - getattr(TRUTH, name)) / fit[name].cramer_rao for name in NAMES]
        )
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15  # 16 runs of 7 parameters: 0.07 or so


class Bank(Model):
    """A damped roll axis that a spring rights."""

    states = outputs = ("p", "phi")
    inputs = ("lat",)

    Lp: Scalar = parameter(default=-2.5, lower=-20.0, upper=0.0, unit="1/s")
    Lphi: Scalar = parameter(default=-1.0, lower=-20.0, upper=5.0, unit="1/s^2")
    Llat: Scalar = parameter(default=10.0, lower=0.0, upper=60.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Lp, self.Lphi], [1, 0]]

    def B(self) -> Rows:
        return [[self.Llat], [0]]


def short_sweep(rng, phase):
    """25 s from 0.6 to 9 rad/s."""
    t = 0.05 * np.arange(500)
    turns = 2 * np.pi * np.cumsum(0.1 + 1.4 * (t / 25) ** 2) * 0.05
    u = 0.1 * np.sin(turns + phase) * np.clip(t - 1, 0, 1) * np.clip(23 - t, 0, 1)
    plant = ([[-2.5, -1.0], [1, 0]], [[10.0], [0]], np.eye(2), np.zeros((2, 1)))
    y = scipy.signal.lsim(plant, u, t)[1] + rng.standard_normal((500, 2)) * [0.06, 0.03]
    return Record(t, u[:, None], y, Bank.inputs, Bank.outputs, f"sweep {phase}")


@pytest.mark.campaign
@pytest.mark.filterwarnings("ignore:.*finer than a record")
def test_a_joint_estimate_with_a_short_sweep_is_as_good_as_it_says():
    # 25 s hold ten lines near a frequency: errors of single points are hardly known.
    truth, z = Bank(), []
    for seed in range(20):
        rng = np.random.default_rng([seed, 25])
        flown, other = (short_sweep(rng, phase) for phase in (1, 2))
        fit = output_error(truth, flown, responses=frequency_response([other]))
        z.append([(row.value - getattr(truth, row.name)) / row.std_error for row in fit.parameters])
    # 60 correlated errors tell it to some 0.15; weighed by their own errors alone it is 1.7.
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4


@pytest.mark.second
def test_what_a_structure_misses_of_a_response_counts_less():
    # Of p to lat the response is another aircraft's above 3 rad/s: errors of 3 % are none.
    stated = measured()
    i, j = stated.index("p", "lat")
    G = stated.G.copy()
    G[OMEGA > 3, i, j] *= 1.5
    wrong = replace(stated, G=G, coherence=np.full(G.shape, 0.9))
    right = replace(stated, coherence=np.full(G.shape, 0.9))
    fits = [output_error(TRUTH, RECORDS, responses=each) for each in (right, wrong)]
    (plain,), (fewer,) = (fit.notes.response_weights for fit in fits)
    assert plain.min() == 1  # errors as stated keep their weight
    assert fewer.min() < 0.15  # 50 % of what is stated as 3 %
    assert np.mean(fewer < 1) < 0.4
    apart = abs(fits[0]["Llat"].value - fits[1]["Llat"].value)
    assert apart < 4 * fits[0]["Llat"].std_error
    again = OutputError(responses=[wrong]).fit(TRUTH, RECORDS, near=fits[1])
    np.testing.assert_array_equal(again.notes.response_weights[0], fewer)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_a_response_in_another_unit_or_of_another_sign_is_told(domain):
    for factor in (-1.0, np.degrees(1.0)):
        stated = measured()
        G = stated.G.copy()
        G[:, stated.index("p", "lat")[0]] *= factor
        with pytest.warns(DataWarning, match=r"p after lat [\d.]+ times.*: a wrong unit or sign"):
            output_error(TRUTH, RECORDS, responses=replace(stated, G=G), domain=domain)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        output_error(TRUTH, RECORDS, responses=measured(), domain=domain)


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:.*rests on few lines")
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_a_response_that_contradicts_the_records_is_told_with_what_it_is_about(domain):
    # 10 % of gain or 20 ms are no more than three errors of any point, and many of all together.
    late = np.exp(-0.02j * OMEGA)[:, None, None]
    for factor, about in ((1.1, r"L(lat|ped) \d"), (late, r"tau \d")):
        wrong = replace(measured(), G=factor * measured().G)
        said = rf"response 2 \(from there\) contradicts the records.* {about}"
        both = [measured(0.3, seed=9), replace(wrong, records=("there",))]
        with pytest.warns(DataWarning, match=said):
            output_error(TRUTH, RECORDS, responses=both, domain=domain)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.filterwarnings("ignore:.*rests on few lines")
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_errors_stated_in_other_units_or_too_small_are_told(domain):
    right = measured()
    cases = (
        (100, "0.0[01].*percent"),
        (8.7, r"0\.1\d? times.*decibels"),
        (0.5, "(1.[6-9]|2).*small"),
    )
    for factor, said in cases:
        wrong = replace(right, random_error=factor * right.random_error)
        with pytest.warns(DataWarning, match=rf"response 1 .* is off by {said}"):
            output_error(TRUTH, RECORDS, responses=wrong, domain=domain)


@pytest.mark.second
@pytest.mark.filterwarnings("error::casid.DataWarning")
def test_errors_of_a_flight_of_its_own_may_be_the_most_that_leakage_makes():
    loose = measured()
    flown = {"records": ("sweep",), "fingerprints": (("another flight",),)}
    loose = replace(loose, random_error=100 * loose.random_error, **flown)
    output_error(TRUTH, RECORDS, responses=loose)


@pytest.mark.second
@pytest.mark.filterwarnings("error::casid.DataWarning")
def test_a_response_of_correlated_errors_contradicts_nothing():
    rng, rho = np.random.default_rng(4), np.exp(-((OMEGA - OMEGA[:, None]) ** 2) / (4 * 0.5**2))
    L, G = np.linalg.cholesky(rho + 1e-10 * np.eye(20)), TRUTH.system().response(OMEGA)
    noise = rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)
    noise = np.tensordot(L, noise, 1)
    alike = replace(measured(), G=G * (1 + 0.03 * noise), resolution=np.full(G.shape, 0.5))
    output_error(TRUTH, RECORDS, responses=alike)


@pytest.mark.second
def test_the_same_numbers_count_once():
    one, other = measured(seed=1), measured(seed=2)
    G = other.G.copy()
    G[3, 1, 0] = one.G[3, 1, 0]
    pair = f"{one.outputs[1]} after {one.inputs[0]}"
    with pytest.raises(ValueError, match=f"two responses have the same numbers of {pair}"):
        output_error(TRUTH, RECORDS, responses=[one, replace(other, G=G)])
    output_error(TRUTH, RECORDS, responses=[one, other])


@pytest.mark.parametrize("digits", [6, 5, 4])
def test_the_same_numbers_rounded_count_once(digits):
    one, other = measured(seed=1), measured(seed=2)

    def printed(x):
        return np.array([float(f"{each:.{digits}g}") for each in np.ravel(x)]).reshape(np.shape(x))

    # As a table has them, in decibels and degrees: 4 digits of 120 degrees are 0.05, 0.001 rad.
    gain, phase = printed(20 * np.log10(np.abs(one.G))), printed(np.degrees(np.angle(one.G)))
    G = 10 ** (gain / 20) * np.exp(1j * np.radians(phase))
    copy = replace(one, omega=printed(one.omega), G=G)
    said = "two responses agree in ay after lat within .* as one does with its numbers rounded"
    for both in ([one, copy], [copy.take(range(0, 20, 3)), one]):
        with pytest.raises(ValueError, match=said):
            check_responses(TRUTH, both, [])
    check_responses(TRUTH, [one, other], [])
    check_responses(TRUTH, [one.between(0.5, 2), copy.between(2.1, 10)], [])


def test_responses_of_other_flights_may_be_closer_than_their_leakage():
    flights = (
        {"records": ("a",), "fingerprints": (("1",),)},
        {"records": ("b",), "fingerprints": (("2",),)},
    )
    both = [replace(measured(), **flown) for flown in flights]
    both[1] = replace(both[1], G=both[1].G * (1 + 1e-4))
    check_responses(TRUTH, both, [])
    with pytest.raises(ValueError, match="two responses agree"):
        check_responses(TRUTH, [both[0], replace(both[1], fingerprints=())], [])


def test_draws_of_records_alone_are_refused():
    joint = OutputError(responses=[measured()])
    with pytest.raises(ValueError, match="responses are the same in every draw"):
        monte_carlo(TRUTH, RECORDS, noise={"p": 0.01}, runs=2, estimator=joint)
