"""The frequency-domain fit against known structures, theory and the definition of its figures."""

import dataclasses

import numpy as np
import pytest
from truths import uh60

from casid import (
    Constraint,
    ConvergenceError,
    DataWarning,
    Derivid,
    Fit,
    FrequencyResponse,
    Model,
    ModelError,
    SolverOptions,
    derivid,
    frequency_response,
    merge_responses,
    parameter,
    response_band,
)
from casid.matching.mismatch import pair_weights, weighted_errors
from casid.values import encode

OMEGA = np.geomspace(0.3, 12.0, 20)
MISFIT = "ignore:derivid. measured responses are farther off than their stated errors"


class Roll(Model):
    states, inputs, outputs = ("v", "p", "phi"), ("lat",), ("p", "phi")

    Yv: float = parameter(default=-0.15, lower=-1.0, upper=0.0, unit="1/s")
    Lv: float = parameter(default=-0.05, lower=-0.5, upper=0.5, unit="rad/(m s)")
    Lp: float = parameter(default=-3.0, lower=-10.0, upper=0.0, unit="1/s")
    Llat: float = parameter(default=8.0, lower=0.0, upper=50.0, unit="rad/s^2")
    tau: float = parameter(default=0.05, lower=0.0, upper=0.3, unit="s")

    def A(self):
        return [[self.Yv, 0, 9.81], [self.Lv, self.Lp, 0], [0, 1, 0]]

    def B(self):
        return [[0], [self.Llat], [0]]

    def delays(self):
        return {"lat": self.tau}


TRUTH = Roll(Yv=-0.2, Lv=-0.08, Lp=-2.5, Llat=11.0, tau=0.08)


def response(model, omega=OMEGA, *, error=0.0, rng=None, coherence=1.0, system=None):
    G = (model.system() if system is None else system).response(omega)
    if error:
        G = G * np.exp(error * (rng.standard_normal(G.shape) + 1j * rng.standard_normal(G.shape)))
    return FrequencyResponse(
        omega=omega, G=G, coherence=np.full(G.shape, coherence),
        random_error=np.full(G.shape, error), inputs=model.inputs, outputs=model.outputs,
        input_std=np.ones(len(model.inputs)), output_std=np.ones(len(model.outputs)),
    )  # fmt: skip


# ---- recovery ----------------------------------------------------------------------------------


def test_a_structure_is_recovered_from_its_own_response():
    fit = derivid(Roll(), response(TRUTH), starts=2)
    # Noise-free: J is zero there, and IPOPT's tolerance of 1e-8 leaves its square root at most.
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-6)
    assert fit.cost < 1e-9
    assert fit.success


@pytest.mark.second
@pytest.mark.filterwarnings(MISFIT)
def test_six_degrees_of_freedom_with_64_parameters_are_recovered():
    rng = np.random.default_rng(1)
    guess = uh60.structure()
    fitted = derivid(
        guess, frequency_response(uh60.sweeps(), omega=np.geomspace(0.4, 12, 20)), starts=1
    ).model
    inside = {  # off the bounds, so that the truth can be reached from both sides
        name: np.clip(value, info.lower + 0.02 * (info.upper - info.lower),
                      info.upper - 0.02 * (info.upper - info.lower))
        for (name, info), value in zip(fitted.infos().items(), fitted.vector(), strict=True)
    }  # fmt: skip
    truth = dataclasses.replace(fitted, **inside)
    assert truth.system().poles()[0].real > 0.05  # unstable, as the helicopter is
    off = truth.vector() * (1 + 0.3 * rng.uniform(-1, 1, 64))
    start = truth.with_vector(off)
    fit = derivid(start, response(truth), starts=2)
    scale = np.maximum(np.abs(truth.vector()), 1e-3)
    np.testing.assert_allclose((fit.model.vector() - truth.vector()) / scale, 0, atol=1e-5)
    assert fit.cost < 1e-8


def test_every_start_but_few_ends_in_the_same_place():
    rng = np.random.default_rng(2)
    fit = derivid(Roll(), response(TRUTH, error=0.03, rng=rng), starts=8)
    costs = np.array([row.J for row in fit.notes.starts])
    assert len(costs) == 8
    assert fit.cost == pytest.approx(costs.min(), rel=1e-9)
    assert np.sum(costs < 1.001 * fit.cost) >= 6


@pytest.mark.filterwarnings(MISFIT)  # of the rotor, which six degrees of freedom lack
@pytest.mark.campaign
def test_half_of_twenty_starts_of_64_parameters_end_in_the_best_place():
    frf = frequency_response(uh60.sweeps(seed=0), omega=np.geomspace(0.4, 12, 40))
    fit = derivid(uh60.structure(), frf, starts=20)
    costs = np.array([row.J for row in fit.notes.starts])
    assert len(costs) == 20
    assert np.sum(costs < 1.001 * fit.cost) >= 10


# ---- the cost ----------------------------------------------------------------------------------


def test_the_fit_minimises_the_cost():
    rng = np.random.default_rng(3)
    frf = response(TRUTH, error=0.05, rng=rng, coherence=0.9)
    fit = derivid(Roll(), frf)
    weight = pair_weights(frf.coherence, np.ones(frf.G.shape, dtype=bool))

    def J(values):
        G = Roll().with_vector(values).system().response(OMEGA)
        return np.sum(weighted_errors(G, frf.G, weight) ** 2)

    best = fit.model.vector()
    assert J(best) == pytest.approx(fit.cost, rel=1e-9)
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-3 * best[i]
        assert J(best + step) > fit.cost
        assert J(best - step) > fit.cost
    assert fit.notes.average == pytest.approx(fit.cost / 2)
    assert sum(row.J for row in fit.notes.pairs) == pytest.approx(fit.cost)


# ---- accuracy figures --------------------------------------------------------------------------


def test_cramer_rao_and_insensitivity_come_from_the_hessian_of_the_cost():
    frf = response(TRUTH, coherence=0.9)
    fit = derivid(Roll(), frf, starts=1)
    weight = pair_weights(frf.coherence, np.ones(frf.G.shape, dtype=bool))
    values = TRUTH.vector()

    def J(x):
        G = Roll().with_vector(x).system().response(OMEGA)
        return np.sum(weighted_errors(G, frf.G, weight) ** 2)

    h = 1e-4 * np.abs(values)
    H = np.empty((5, 5))
    for i in range(5):
        for j in range(5):
            a, b = np.eye(5)[i] * h, np.eye(5)[j] * h
            H[i, j] = (J(values + a + b) - J(values + a - b) - J(values - a + b)
                       + J(values - a - b)) / (4 * h[i] * h[j])  # fmt: skip
    std, insensitive = np.sqrt(np.diag(np.linalg.inv(H))), 1 / np.sqrt(np.diag(H))
    table = {row.name: row for row in fit.notes.table}
    # Central differences with a step of 1e-4: an error of its square times the fourth derivative.
    for i, name in enumerate(Roll.parameter_names()):
        assert fit[name].cramer_rao == pytest.approx(std[i], rel=1e-4)
        assert fit[name].insensitivity == pytest.approx(insensitive[i], rel=1e-4)
        percent = 100 / abs(values[i])
        assert table[name].cramer_rao_percent == pytest.approx(2 * std[i] * percent, rel=1e-4)
        assert table[name].insensitivity_percent == pytest.approx(
            insensitive[i] * percent, rel=1e-4
        )


@pytest.mark.slow
@pytest.mark.parametrize("error", [pytest.param(0.003, marks=pytest.mark.campaign), 0.03])
def test_errors_are_those_of_repeated_measurements(error):
    rng = np.random.default_rng(4)
    fits = [derivid(Roll(), response(TRUTH, error=error, rng=rng), starts=1) for _ in range(40)]
    off = np.array([fit.model.vector() for fit in fits]) - TRUTH.vector()
    stated = np.mean([[row.std_error for row in fit.parameters] for fit in fits], axis=0)
    # A standard deviation from 40 runs is known to 11 %; three of these.
    np.testing.assert_allclose(np.std(off, axis=0) / stated, 1, atol=0.35)
    # χ² of five degrees of freedom has variance 10: the mean of 40 is known to 0.5.
    squares = [e @ np.linalg.solve(fit.covariance, e) for e, fit in zip(off, fits, strict=True)]
    assert np.mean(squares) == pytest.approx(5, abs=1.5)
    assert fits[0].notes.table[2].scatter == fits[0].parameters[2].std_error


@pytest.mark.second
def test_a_band_of_a_fit_in_decibels_holds_the_truth():
    rng = np.random.default_rng(5)
    held = []
    for _ in range(25):
        fit = derivid(Roll(), response(TRUTH, error=0.02, rng=rng), starts=1)
        low, high = response_band(fit, OMEGA).magnitude()
        size = np.abs(TRUTH.system().response(OMEGA))
        held.append(np.mean((low <= size) & (size <= high)))
    # 40 points of a curve of five parameters are about ten independent ones: 250 of 95 % scatter
    # by 1.4 %.
    assert np.mean(held) == pytest.approx(0.95, abs=0.045)


def test_without_stated_errors_the_cost_alone_is_said_to_be_the_error():
    frf = response(TRUTH, error=0.05, rng=np.random.default_rng(3))
    known = derivid(Roll(), frf, starts=1)
    unknown = dataclasses.replace(frf, random_error=np.full(frf.G.shape, np.nan))
    with pytest.warns(DataWarning, match="states no errors at some of the fitted points"):
        fit = derivid(Roll(), unknown, starts=1)
    assert fit["Lp"].std_error == fit["Lp"].cramer_rao == known["Lp"].cramer_rao
    assert np.isnan(fit.notes.table[2].scatter)


def test_guidelines_mark_what_they_are_missed_by():
    fit = derivid(Roll(), response(TRUTH), starts=1, pairs={("phi", "lat"): (8.0, 12.0)})
    table = {row.name: row for row in fit.notes.table}
    assert "CR" in table["Yv"].misses  # high frequencies say nothing of speed damping
    assert "I" in table["Yv"].misses
    full = derivid(Roll(), response(TRUTH), starts=1)
    assert not next(row for row in full.notes.table if row.name == "Llat").misses


def test_what_a_structure_misses_of_a_response_is_told_by_pair_and_enters_the_errors():
    # A lag of 0.1 s that the structure lacks; J, far below its guideline, does not know of it.
    rng = np.random.default_rng(6)
    lagged = response(TRUTH)
    lagged = dataclasses.replace(lagged, G=lagged.G / (1 + 0.1j * OMEGA[:, None, None]))
    noise = rng.standard_normal(lagged.G.shape) + 1j * rng.standard_normal(lagged.G.shape)
    known = {"random_error": np.full(lagged.G.shape, 0.003)}
    frf = dataclasses.replace(lagged, G=lagged.G * np.exp(0.003 * noise), **known)
    with pytest.warns(DataWarning, match=r"p after lat \d+ times, phi after lat \d+ times") as told:
        fit = derivid(Roll(), frf, starts=2)
    assert len(told) == 1
    assert "parameters can be off by more" in str(told[0].message)
    assert fit.notes.average < 20
    sound = derivid(Roll(), response(TRUTH, error=0.003, rng=rng), starts=2)
    assert fit["Lp"].std_error > 4 * sound["Lp"].std_error


@pytest.mark.second
def test_a_true_structure_misses_nothing_of_a_response_as_well_known_as_stated_or_better():
    for seed in range(10):  # tests raise on any warning
        rng = np.random.default_rng(seed)
        frf = response(TRUTH, error=0.01, rng=rng)
        derivid(Roll(), frf, starts=1)
        derivid(Roll(), dataclasses.replace(frf, random_error=4 * frf.random_error), starts=1)


# ---- bounds, ties, choices ---------------------------------------------------------------------


@pytest.mark.filterwarnings(MISFIT)
def test_a_pair_is_marked_that_fits_badly():
    good = derivid(Roll(), response(TRUTH), starts=2)
    assert [row.misses for row in good.notes.pairs] == [(), ()]
    bad = derivid(Roll(Lp=-9.0), response(TRUTH), starts=2, fixed={"Lp"}, bounds={"Llat": (0, 4)})
    assert {row.misses for row in bad.notes.pairs if row.J > 100} == {("J",)}


@pytest.mark.filterwarnings(MISFIT)
def test_a_delay_stays_at_zero_where_the_data_want_a_lead():
    lead = Roll(Yv=-0.2, Lv=-0.08, Lp=-2.5, Llat=11.0, tau=0.0)
    frf = response(lead)
    frf = dataclasses.replace(frf, G=frf.G * np.exp(0.03j * OMEGA)[:, None, None])
    fit = derivid(Roll(), frf, starts=2)
    assert fit["tau"].value == pytest.approx(0.0, abs=1e-7)
    assert fit["tau"].lower == 0.0
    assert fit["tau"].active
    assert fit["tau"].multiplier > 0
    assert np.isnan(fit["tau"].std_error)


@pytest.mark.second
@pytest.mark.filterwarnings(MISFIT)
def test_a_tie_between_parameters_holds():
    class TiedRoll(Model):
        states, inputs, outputs = ("p",), ("lat",), ("p",)
        Lp: float = parameter(default=-3.0, lower=-9.0, upper=0.0, unit="1/s")
        Llat: float = parameter(default=5.0, lower=0.0, upper=50.0, unit="rad/s^2")
        lag: float = parameter(default=0.05, lower=0.01, upper=0.3, unit="s")

        def A(self):
            return [[self.Lp]]

        def B(self):
            return [[self.Llat]]

        def delays(self):
            return {"lat": 2 * self.lag - 0.02}

        def constraints(self):
            return [Constraint("steady", self.Llat + 4 * self.Lp)]

    truth = TiedRoll(Lp=-2.0, Llat=8.0, lag=0.06)
    fit = derivid(TiedRoll(), response(truth), starts=2)
    np.testing.assert_allclose(fit.model.vector(), truth.vector(), rtol=1e-6)
    lead = response(truth)
    lead = dataclasses.replace(lead, G=lead.G * np.exp(0.2j * OMEGA)[:, None, None])
    # The delay is composed of a parameter, so a constraint keeps it at 0, not a bound.
    assert derivid(TiedRoll(), lead, starts=1).model.lag == pytest.approx(0.01, abs=1e-6)


@pytest.mark.filterwarnings(MISFIT)
def test_fixed_parameters_and_bounds_are_kept():
    fit = derivid(
        dataclasses.replace(Roll(), Yv=-0.3), response(TRUTH), fixed={"Yv"}, starts=2,
        bounds={"Lp": (-1.5, 0.0)},
    )  # fmt: skip
    assert fit.model.Yv == -0.3
    assert fit["Yv"].fixed
    assert fit["Lp"].value == pytest.approx(-1.5)
    assert fit["Lp"].active


def test_pairs_without_coherence_are_left_out_unless_named():
    frf = response(TRUTH)
    low = frf.coherence.copy()
    low[:, 0] = 0.4
    frf = dataclasses.replace(frf, coherence=low)
    fit = derivid(Roll(), frf, starts=1)
    assert [(row.output, row.input) for row in fit.notes.pairs] == [("phi", "lat")]
    named = derivid(Roll(), frf, starts=1, pairs=[("p", "lat")])
    assert [row.output for row in named.notes.pairs] == ["p"]
    ranged = derivid(Roll(), frf, starts=1, pairs={("p", "lat"): None, ("phi", "lat"): (1, 5)})
    assert ranged.notes.pairs[1].band[1] <= 5
    assert ranged.notes.pairs[1].points == np.sum((OMEGA >= 1) & (OMEGA <= 5))


def test_twenty_points_are_taken_from_a_finer_response():
    fine = np.geomspace(0.2, 20, 200)
    fit = derivid(Roll(), response(TRUTH, fine), starts=1, band=(0.5, 10))
    for row in fit.notes.pairs:
        assert row.points == 20
        assert row.band == (pytest.approx(0.5, rel=0.03), pytest.approx(10, rel=0.03))


def test_channels_are_found_by_name():
    frf = response(TRUTH)
    swapped = dataclasses.replace(
        frf, G=frf.G[:, ::-1], coherence=frf.coherence[:, ::-1], outputs=("phi", "p"),
        random_error=frf.random_error[:, ::-1],
    )  # fmt: skip
    fit = derivid(Roll(), swapped, starts=1)
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-6)


def test_a_saved_fit_reads_back(tmp_path):
    fit = derivid(Roll(), response(TRUTH), starts=1)
    fit.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json", model=Roll)
    assert again.model == fit.model
    assert encode(again.notes) == encode(fit.notes)


# ---- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"starts": 0}, "starts=0"),
        ({"n_omega": 1}, "n_omega=1: expected 2"),
        ({"coherence": 1.0}, "coherence=1.0: expected 0 or more, below 1"),
        ({"pairs": [("p", "lon")]}, r"no pair \('p', 'lon'\)"),
        ({"pairs": []}, "pairs is empty"),
        (
            {"pairs": ("p", "lat")},
            r"pairs = .*, expected several .*; write \[\('p', 'lat'\)\]",
        ),
        ({"pairs": {("p", "lat"): (50.0, 60.0)}}, "was not measured between 50 and 60"),
        ({"band": (100.0, 200.0)}, "no point between 100 and 200"),
    ],
)
def test_bad_requests_are_refused(choices, message):
    with pytest.raises(ValueError, match=message):
        Derivid(**choices).fit(Roll(), response(TRUTH))


def test_what_is_no_measured_response_is_refused():
    with pytest.raises(ValueError, match="target = None, expected FrequencyResponse"):
        derivid(Roll(), None)


def test_several_responses_are_for_the_caller_to_merge():
    both = [response(TRUTH), response(TRUTH)]
    with pytest.raises(ValueError, match=r"not 2; combine them with merge_responses\("):
        derivid(Roll(), both)
    assert "are merged" not in derivid.__doc__
    assert derivid(Roll(), merge_responses(both), starts=1).cost < 1e-8


def test_a_constraint_that_contradicts_bounds_is_named():
    class Beyond(Roll):
        def constraints(self):
            return [Constraint("steep", self.Llat, 1e3, np.inf)]

    with pytest.raises(ConvergenceError, match=r"'steep' is 50, wanted between 1000 and inf"):
        derivid(Beyond(), response(TRUTH), starts=1)


def test_a_response_without_coherence_is_refused():
    with pytest.raises(ValueError, match="no pair has coherence >="):
        derivid(Roll(), response(TRUTH, coherence=0.2))


def test_a_response_of_which_nothing_is_known_is_refused_with_its_reasons():
    known = response(TRUTH)
    lost = dataclasses.replace(
        known, G=np.full_like(known.G, np.nan), flags={"losses leave too few windows": (0, 1)}
    )
    for pairs in (None, [("p", "lat")]):
        with pytest.raises(ValueError, match=r"no point .* is known \(losses leave too few wind"):
            derivid(Roll(), lost, pairs=pairs)


def test_a_parameter_on_which_nothing_depends_is_named():
    class Idle(Model):
        states, inputs, outputs = ("p",), ("lat",), ("p",)
        Lp: float = parameter(default=-3.0, unit="1/s")
        Llat: float = parameter(default=5.0, unit="rad/s^2")
        Nothing: float = parameter(default=1.0, unit="-")

        def A(self):
            return [[self.Lp]]

        def B(self):
            return [[self.Llat]]

    with pytest.raises(ModelError, match="Nothing has no effect on any weighted response"):
        derivid(Idle(), response(Idle()))


def test_an_input_of_another_name_is_named_where_its_parameters_have_no_effect():
    class Two(Model):
        states, inputs, outputs = ("p",), ("lat", "lon"), ("p",)
        Lp: float = parameter(default=-3.0, unit="1/s")
        Llat: float = parameter(default=5.0, unit="rad/s^2")
        Llon: float = parameter(default=1.0, unit="rad/s^2")

        def A(self):
            return [[self.Lp]]

        def B(self):
            return [[self.Llat, self.Llon]]

    measured = dataclasses.replace(response(Two()), inputs=("lat", "dlon"))
    with pytest.raises(ModelError, match=r"Llon has no effect .* no input 'lon', but lat, dlon"):
        derivid(Two(), measured, starts=1)
    assert derivid(Two(), measured, fixed={"Llon"}, starts=1)["Lp"].value == pytest.approx(-3.0)


def test_a_delay_that_may_be_negative_is_refused():
    with pytest.raises(ModelError, match=r"that of 'lat' may be -0\.1 s between the bounds of tau"):
        derivid(Roll(), response(TRUTH), bounds={"tau": (-0.1, 0.3)})


def test_no_convergence_hands_over_the_best_iterate():
    with pytest.raises(ConvergenceError, match="none of 2 starts converged") as caught:
        derivid(Roll(), response(TRUTH), starts=2, solver=SolverOptions(max_iterations=1))
    best = caught.value.best
    assert not best.success
    assert len(best.notes.starts) == 2
    assert np.isfinite(best.model.vector()).all()


@pytest.mark.filterwarnings("ignore:derivid. the response states no errors")
def test_prior_values_are_information_beside_the_cost():
    frf = response(TRUTH, error=0.05, rng=np.random.default_rng(3), coherence=0.9)
    frf = dataclasses.replace(frf, random_error=np.full(frf.G.shape, np.nan))
    alone = derivid(Roll(), frf, starts=1)  # its covariance is H⁻¹
    std = alone["Lp"].std_error
    prior = alone["Lp"].value + 0.1 * std
    fit = derivid(Roll(), frf, starts=1, priors={"Lp": (prior, std)})
    F = np.linalg.inv(alone.covariance)
    pull = np.array([float(name == "Lp") for name in alone.free_names]) / std**2
    posterior = np.linalg.inv(F + np.diag(pull))
    values = np.array([alone[name].value for name in alone.free_names])
    expected = posterior @ (F @ values + pull * prior)
    found = np.array([fit[name].value for name in fit.free_names])
    errors = np.sqrt(np.diag(posterior))
    np.testing.assert_allclose(found / errors, expected / errors, atol=0.01)  # nearly quadratic
    unit = np.outer(errors, errors)
    np.testing.assert_allclose(fit.covariance / unit, posterior / unit, atol=0.01)
    assert fit.cost > alone.cost


def test_a_value_known_before_keeps_the_error_it_was_known_with():
    frf = response(TRUTH, error=0.05, rng=np.random.default_rng(3), coherence=0.9)
    alone = derivid(Roll(), frf, starts=1)
    std = 1e-2 * alone["Lp"].std_error  # the response adds next to nothing
    fit = derivid(Roll(), frf, starts=1, priors={"Lp": (alone["Lp"].value, std)})
    assert fit["Lp"].std_error == pytest.approx(std, rel=1e-2)


def test_what_a_bound_leaves_open_is_what_is_known_without_it_but_for_one_side():
    frf = response(Roll(), error=0.03, rng=np.random.default_rng(4))
    free = derivid(Roll(), frf)
    lower = free["Lp"].value + 0.5 * free["Lp"].std_error
    fit = derivid(Roll(), frf, bounds={"Lp": (lower, 0.0)})
    k, P = free.free_names.index("Lp"), free.covariance
    assert fit["Lp"].active
    held = P - np.outer(P[k], P[k]) / P[k, k]
    expected = np.sqrt(np.diag(held + 0.680 * np.outer(P[k], P[k]) / P[k, k]))  # of N(-1/2, 1) > 0
    for name, std in zip(fit.free_names, expected, strict=True):
        if name != "Lp":
            assert fit[name].std_error == pytest.approx(std, rel=0.1)
    assert fit.covariance[k, k] == pytest.approx(0.680 * P[k, k], rel=0.2)


class Coupled(Model):
    """Two rates that sticks drive across."""

    states, inputs, outputs = ("p", "q"), ("a", "b"), ("p", "q")

    Lp: float = parameter(default=-2.0, lower=-9, upper=0, unit="1/s")
    Lq: float = parameter(default=0.5, lower=-9, upper=9, unit="1/s")
    Mp: float = parameter(default=-0.7, lower=-9, upper=9, unit="1/s")
    Mq: float = parameter(default=-1.0, lower=-9, upper=0, unit="1/s")
    La: float = parameter(default=5.0, lower=0, upper=20, unit="1/s^2")
    Mb: float = parameter(default=3.0, lower=0, upper=20, unit="1/s^2")

    def A(self):
        return [[self.Lp, self.Lq], [self.Mp, self.Mq]]

    def B(self):
        return [[self.La, 0], [0, self.Mb]]


def test_what_the_pairs_that_are_left_do_not_determine_is_named_with_those_left_out():
    # On the diagonal stands (s - Mq) La / (s² - (Lp + Mq) s + Lp Mq - Lq Mp): Lq Mp as a product.
    whole = response(Coupled(), error=0.02, rng=np.random.default_rng(0))
    coherence = np.where(np.eye(2) > 0, 0.95, 0.2) * np.ones_like(whole.coherence)
    said = r"do not determine Lq, Mp one by one.*: p by b, q by a\)"
    with pytest.warns(DataWarning, match=said):
        fit = derivid(Coupled(), dataclasses.replace(whole, coherence=coherence), starts=1)
    assert np.isinf([fit["Lq"].std_error, fit["Mp"].std_error]).all()
    assert fit["Lp"].std_error < 1
    derivid(Coupled(), whole, starts=1)  # without a word
