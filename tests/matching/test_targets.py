import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, YAW, HoverRoll, Lag, TwoByTwo, black_box

from casid import (
    Constraint,
    ConvergenceError,
    FrequencyResponse,
    Match,
    Model,
    ModelError,
    Rows,
    Scalar,
    StateSpace,
    match,
    parameter,
)
from casid.free import free_parameters
from casid.matching.programme import Programme
from casid.matching.targets import comparison_of

OMEGA = np.geomspace(0.1, 10.0, 40)
MISFIT = "ignore:match. measured responses are farther off than their stated errors"


def measured(system, omega=OMEGA, coherence=1.0, **changes):
    """A measured response that knows the truth."""
    G = system.response(omega)
    return FrequencyResponse(
        **{
            "omega": omega,
            "G": G,
            "coherence": np.full(G.shape, coherence),
            "random_error": np.zeros(G.shape),
            "inputs": system.inputs,
            "outputs": system.outputs,
            "input_std": np.ones(system.nu),
            "output_std": np.ones(system.ny),
        }
        | changes
    )


def corrupted():
    """The yaw dynamics with a wrong direct term from pedal to roll rate."""
    system = YAW.system()
    D = np.array([[0.0, 5.0], [0.0, 0.0]])
    names = system.inputs, system.outputs
    return StateSpace(system.A, system.B, system.C, D, None, *names, delay=system.delay)


def test_default_scaling_is_that_of_the_standard_deviations():
    std = {"input_std": np.array([2.0, 0.5]), "output_std": np.array([0.1, 4.0])}
    comparison = comparison_of(TwoByTwo(), [black_box(YAW.system(), **std)], omega=OMEGA)
    error = TwoByTwo().system().response(OMEGA) - YAW.system().response(OMEGA)
    scaled = np.diag(1 / std["output_std"]) @ error @ np.diag(std["input_std"])
    np.testing.assert_allclose(comparison.error(TwoByTwo().system()), scaled, rtol=1e-12)


def test_relative_error_divides_each_output_by_its_own_response():
    std = {"input_std": np.array([2.0, 0.5]), "output_std": np.array([0.1, 4.0])}
    comparison = comparison_of(
        TwoByTwo(), [black_box(YAW.system(), **std)], omega=OMEGA, weight="relative"
    )
    G = YAW.system().response(OMEGA)
    size = np.linalg.norm(G @ np.diag(std["input_std"]), axis=2)
    error = (TwoByTwo().system().response(OMEGA) - G) @ np.diag(std["input_std"]) / size[:, :, None]
    np.testing.assert_allclose(comparison.error(TwoByTwo().system()), error, rtol=1e-12)


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_masked_pair_does_not_count(norm):
    mask = np.array([[1.0, 0.0], [1.0, 1.0]])
    fit = match(TwoByTwo(), black_box(corrupted()), norm=norm, weight=mask)
    np.testing.assert_allclose(fit.model.vector(), YAW.vector(), rtol=1e-5)
    assert match(TwoByTwo(), black_box(corrupted()), norm=norm).cost > 1.0


def test_frequencies_of_weight_zero_do_not_count():
    G = YAW.system().response(OMEGA)
    G[OMEGA > 5.0] += 3.0
    weight = (OMEGA <= 5.0).astype(float)[:, None, None]
    target = measured(YAW.system(), G=G)
    fit = match(TwoByTwo(), target, norm="hinf", weight=weight)
    np.testing.assert_allclose(fit.model.vector(), YAW.vector(), rtol=1e-5)


def test_weights_follow_their_frequencies_in_any_order():
    box, model = black_box(corrupted()), TwoByTwo().system()
    weight = np.geomspace(1.0, 1e-3, 40)[:, None, None]
    sorted_, mixed = (
        comparison_of(TwoByTwo(), [box], omega=OMEGA[order], weight=weight[order]).error(model)
        for order in (np.arange(40), np.random.default_rng(1).permutation(40))
    )
    np.testing.assert_array_equal(mixed, sorted_)


def test_incoherent_and_missing_points_do_not_count():
    system = YAW.system()
    G, coherence = system.response(OMEGA), np.ones((40, 2, 2))
    G[:20, 0, 0] += 1.0
    coherence[:20, 0, 0] = 0.3
    G[5, 1, 1] = coherence[5, 1, 1] = np.nan
    fit = match(TwoByTwo(), measured(system, G=G, coherence=coherence), norm="quadratic")
    np.testing.assert_allclose(fit.model.vector(), YAW.vector(), rtol=1e-5)


def test_two_sources_share_a_gain_as_their_weights_say():
    # One free gain: weighted least squares in closed form, Σ w² k / Σ w²; coherence 1 gives the
    # measured error the factor 1.58 (1 − 1/e).
    unit = Lag(a=1.0, k=1.0)
    three = Lag(a=1.0, k=3.0)
    for factor in (0.5, 1.0, 2.0):
        targets = [black_box(unit.system()), measured(three.system())]
        matching = Match(
            norm="quadratic", omega=OMEGA, shift=0.0, source_weight=(1.0, factor), weight="size"
        )
        fit = matching.fit(Lag(a=1.0), targets, fixed=("a",))
        w = (factor * 1.58 * (1 - np.exp(-1.0))) ** 2
        assert fit["k"].value == pytest.approx((1 + 3 * w) / (1 + w), rel=1e-6)
        rows = fit.notes.sources
        assert [row.name for row in rows] == ["black box", "measured"]
        assert sum(row.share for row in rows) == pytest.approx(1.0)
        shares = [1.0 * (fit["k"].value - 1) ** 2, w * (fit["k"].value - 3) ** 2]
        assert rows[1].share == pytest.approx(shares[1] / sum(shares), rel=1e-6)


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_a_state_space_is_a_target_as_it_is(norm):
    fit = match(HoverRoll(), TRUTH.system(), norm=norm)
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-6)
    moduli = np.abs(TRUTH.system().poles())
    assert fit.certificate.band == pytest.approx((moduli.min() / 3, 3 * moduli.max()))
    given = np.geomspace(1e-3, 50.0, 30)  # wherever wanted: it is known everywhere
    assert match(HoverRoll(), TRUTH.system(), norm=norm, omega=given).certificate.band[1] == 50.0


def test_a_gain_alone_needs_its_frequencies():
    gain = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]],
                      inputs=("u",), outputs=("x",))  # fmt: skip
    with pytest.raises(ValueError, match="give omega"):
        match(Lag(), gain)


def test_coherence_weighs_the_squared_error_as_tischler_and_remple_say():
    # One free gain at coherence 0.6 against a black box: weighted least squares in closed form.
    # T&R (11.1): W = [1.58 (1 - exp(-γ²))]², and the coherence is γ² already.
    unit, three = Lag(a=1.0, k=1.0), Lag(a=1.0, k=3.0)
    targets = [black_box(unit.system()), measured(three.system(), coherence=0.6)]
    fit = match(
        Lag(a=1.0), targets, norm="quadratic", fixed=("a",), omega=OMEGA, shift=0.0, weight="size"
    )
    w = (1.58 * (1 - np.exp(-0.6))) ** 2
    assert fit["k"].value == pytest.approx((1 + 3 * w) / (1 + w), rel=1e-6)


@pytest.mark.second
def test_measured_points_alone_recover_an_unstable_structure():
    fit = match(HoverRoll(), measured(TRUTH.system()), norm="hinf")
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-5)
    assert fit.certificate.shift == 0.0


def test_black_box_is_shifted_and_measured_points_are_not():
    targets = [black_box(TRUTH.system()), measured(TRUTH.system())]
    comparison = comparison_of(HoverRoll(), targets, shift=0.3)
    assert (comparison.sources[0].s.real == 0.3).all()
    assert (comparison.sources[1].s.real == 0.0).all()
    fit = match(HoverRoll(), targets, norm="hinf")
    np.testing.assert_allclose(fit.model.vector(), TRUTH.vector(), rtol=1e-5)


class Tied(TwoByTwo):
    """Lateral stick yaws in a fixed ratio to its roll; both controls share one delay."""

    def constraints(self):
        return [
            Constraint("Nlat = 0.1 Llat", self.Nlat - 0.1 * self.Llat),
            Constraint("one delay", self.tau_lat - self.tau_ped),
        ]


@pytest.mark.second
@pytest.mark.parametrize("norm", ["quadratic", "hinf"])
def test_ties_hold_at_the_optimum(norm):
    fit = match(Tied(), black_box(YAW.system()), norm=norm)
    assert fit["Nlat"].value == pytest.approx(0.1 * fit["Llat"].value, rel=1e-6)
    assert fit["tau_lat"].value == pytest.approx(fit["tau_ped"].value, rel=1e-6)
    assert fit.cost > match(TwoByTwo(), black_box(YAW.system()), norm=norm).cost


@pytest.mark.second
def test_tied_truth_is_recovered():
    values = {name: getattr(YAW, name) for name in YAW.parameter_names()}
    truth = Tied(**values | {"Nlat": 1.2, "tau_ped": 0.06})
    fit = match(Tied(), black_box(truth.system()))
    np.testing.assert_allclose(fit.model.vector(), truth.vector(), rtol=1e-5)


class Damped(Model):
    """An oscillator whose damping ratio must be at least one half."""

    states = ("q", "theta")
    inputs = ("lon",)
    outputs = ("theta",)

    Mq: Scalar = parameter(default=-1.0, lower=-10.0, upper=0.0, unit="1/s")
    Mtheta: Scalar = parameter(default=-1.0, lower=-20.0, upper=-0.1, unit="1/s^2")
    Mlon: Scalar = parameter(default=1.0, lower=0.0, upper=20.0, unit="rad/s^2")

    def A(self) -> Rows:
        return [[self.Mq, self.Mtheta], [1, 0]]

    def B(self) -> Rows:
        return [[self.Mlon], [0]]

    def constraints(self):
        return [Constraint("damping ratio", self.Mq**2 + self.Mtheta, lower=0.0, upper=np.inf)]


@pytest.mark.second
def test_modal_damping_bound_is_active_where_the_truth_violates_it():
    truth = Damped(Mq=-0.8, Mtheta=-4.0, Mlon=3.0)  # damping ratio 0.2
    fit = match(Damped(), black_box(truth.system()), norm="hinf")
    natural, damping = np.sqrt(-fit["Mtheta"].value), -fit["Mq"].value
    assert damping / (2 * natural) == pytest.approx(0.5, rel=1e-6)


@pytest.mark.second
def test_constraint_that_bounds_contradict_is_named():
    with pytest.raises(ConvergenceError, match="relax ties and bounds") as caught:
        match(Tied(), black_box(YAW.system()), bounds={"Nlat": (8.0, 10.0), "Llat": (1.0, 20.0)})
    assert not caught.value.best.success


def test_fixed_parameters_are_no_variables():
    comparison = comparison_of(TwoByTwo(), [black_box(YAW.system())])
    sizes = []
    for fixed in ((), ("Lr", "Np", "tau_ped")):
        free = free_parameters(TwoByTwo(), fixed)
        sizes.append(len(Programme(free, comparison, "quadratic", free.guess).problem().x0))
    assert sizes[0] - sizes[1] == 3
    fit = match(TwoByTwo(Lr=0.4), black_box(YAW.system()), norm="quadratic", fixed=("Lr",))
    assert fit["Lr"].fixed
    assert fit["Lr"].value == 0.4
    np.testing.assert_allclose(fit.model.vector(), YAW.vector(), rtol=1e-5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"weight": "log"}, 'expected "reachable", "relative", "size" or an array'),
        ({"weight": np.ones((7, 2, 2))}, r"expected \(K, ny, nu\) = \(40, 2, 2\)"),
        ({"weight": -np.ones((2, 2))}, "negative or non-finite"),
        ({"weight": np.zeros((2, 2))}, "no point of the target weighs on output 'p'"),
        ({"source_weight": (1.0, 2.0)}, "expected 1 positive numbers, one a target"),
        ({"omega": np.array([0.0, 1.0])}, "above 0 rad/s"),
        ({"omega": np.ones((2, 2))}, "in one dimension"),
        ({"shift": -0.1}, "expected a finite number, 0 or more"),
    ],
)
def test_wrong_weights_and_grids_are_explained(given, message):
    with pytest.raises(ValueError, match=message):
        Match(**given).fit(TwoByTwo(), black_box(YAW.system()))


def test_target_of_another_kind_is_refused():
    with pytest.raises(ValueError, match=r"target = \[Lag\(.*expected BlackBox"):
        match(Lag(), [Lag()])
    discrete = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1, ("u",), ("x",))
    with pytest.raises(ValueError, match="convert it to continuous time"):
        match(Lag(), discrete)
    with pytest.raises(ValueError, match="no target"):
        match(Lag(), [])
    with pytest.raises(ValueError, match="measured points cannot move"):
        match(Lag(), measured(SECOND), shift=0.2)
    with pytest.raises(ModelError, match="every parameter is fixed"):
        match(Lag(), black_box(SECOND), fixed=("a", "k"))


@pytest.mark.second
@pytest.mark.filterwarnings(MISFIT)
def test_a_certificate_says_which_targets_exist_at_their_points_alone():
    seen, box, omega = measured(SECOND, np.geomspace(1, 10, 6)), black_box(SECOND), OMEGA
    assert match(Lag(), seen, weight="size").certificate.at_points == ("measured",)
    both = match(Lag(), [box, seen], omega=omega, weight="size").certificate
    assert both.at_points == ("measured",)
    assert match(Lag(), box, weight="size").certificate.at_points == ()
