"""The stage of output error."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal
from truths.closed_roll import NOISE, TRUTH, T, excitation, noisy, off

from casid import DataWarning, FrequencyResponse, OutputError, Record, output_error
from casid.records import steps_told
from casid.report import OUTPUT_ERROR as LABEL
from casid.report.content import CHOSEN
from casid.stages.refinement import OUTPUT_ERROR, _better_as_steps
from casid.stages.stage import Task, records_of


def test_it_goes_on_from_the_match_on_its_own_records_or_those_of_identification():
    start, records = off(share=0.1), (noisy(1),)
    task = Task(
        model=TRUTH, records=records, results={"hinf": SimpleNamespace(model=start)},
        fixed=("Lped",), bounds={"Lp": (-5.0, -0.5)},
    )  # fmt: skip
    own = OutputError(interval=2.0)
    found = OUTPUT_ERROR.run(own, task)
    direct = output_error(start, records, interval=2.0, fixed=task.fixed, bounds=task.bounds)
    assert found.model == direct.model
    assert found["Lped"].fixed
    assert found["Lp"].lower == -5.0
    assert OUTPUT_ERROR.data(own, task) == records
    roles = {"identification": (1,), "refinement": (2,)}
    assert records_of(OUTPUT_ERROR, roles) == (2,)
    assert records_of(OUTPUT_ERROR, {"identification": (1,)}) == (1,)


@pytest.mark.second
@pytest.mark.parametrize(
    ("held", "said"),
    [("zoh", r"as no hold was stated; the records are e\^\d\d times as likely with steps"),
     ("foh", "^lat moves in steps, .*; here the records are not clearly more likely with steps$")],
)  # fmt: skip
def test_it_tells_of_inputs_in_steps_which_reading_explains_records_better(held, said):
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-0.3, 0.0, 0.3], (20, 2)), 30, axis=0)
    y = TRUTH.system().simulate(T, u, hold=held)
    record = Record(T, u, y, TRUTH.inputs, TRUTH.outputs, "steps").with_noise(NOISE, rng)
    task = Task(model=TRUTH, records=(record,))
    with pytest.warns(DataWarning, match=said) as told:
        found = OUTPUT_ERROR.run(OutputError(), task)
    assert found.success
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        OUTPUT_ERROR.run(OutputError(), replace(task, hold="foh"))  # stated: not asked again


@pytest.mark.second
def test_it_tells_of_inputs_that_a_computer_holds_while_it_feeds_noise_back():
    """Nothing rests there, so that no jump shows; the delay is half a sample too long."""
    late, rng, noise = 4, np.random.default_rng(3), [NOISE[name] for name in TRUTH.outputs]
    dt, N, model = T[1], 2 * len(T), replace(TRUTH, tau=4 * T[1])
    plant = model.system()
    A, B, C, D, _ = scipy.signal.cont2discrete((plant.A, plant.B, plant.C, plant.D), dt)
    u, y, x = excitation(dt * np.arange(N), 3), np.zeros((N, 3)), np.zeros(3)
    for k in range(N):
        acting = np.array([u[k - late, 0] if k >= late else 0.0, u[k, 1]])
        y[k] = C @ x + D @ acting + noise * rng.standard_normal(3)
        u[k, 0] -= 0.01 * y[k, 1] + 0.03 * y[k, 2]
        x = A @ x + B @ acting
    record = Record(dt * np.arange(N), u, y, model.inputs, model.outputs, "digital")
    with pytest.warns(DataWarning, match=r"are e\^\d\d times as likely with steps"):
        lines = OUTPUT_ERROR.run(OutputError(), Task(model=model, records=(record,)))
    assert lines["tau"].value - model.tau == pytest.approx(dt / 2, abs=0.2 * dt)
    assert not steps_told(record, ["lat"])
    steps = output_error(model, [replace(record, hold="zoh")])["tau"]
    assert abs(steps.value - model.tau) < 3 * steps.std_error < dt / 4


@pytest.mark.second
@pytest.mark.parametrize(
    "settings", [OutputError(), OutputError(R=np.diag(list(NOISE.values())) ** 2),
                 OutputError(domain="frequency")],
)  # fmt: skip
def test_how_much_likelier_steps_are_is_what_a_fit_of_initial_states_and_biases_finds(settings):
    records = [noisy(1), noisy(2)]
    fit = settings.fit(TRUTH, records)
    late = replace(fit.model, tau=fit["tau"].value - T[1] / 2)
    steps = [replace(record, hold="zoh") for record in records]
    held = [name for name in fit.free_names if name != "Yv"]
    there = settings.fit(late, steps, fixed=held, near=fit)  # one has to be free
    slack = 3 * 3.84 / 2  # what one parameter more may gain by chance, thrice
    assert fit.cost - there.cost - slack < _better_as_steps(settings, fit, records)
    assert _better_as_steps(settings, fit, records) < fit.cost - there.cost + 1e-3


@pytest.mark.parametrize("domain", ["time", "frequency"])
@pytest.mark.second
def test_responses_say_nothing_of_how_records_hold_their_inputs(domain):
    omega = np.geomspace(0.5, 10.0, 12)
    G = TRUTH.system().response(omega)
    exact = FrequencyResponse(
        omega=omega, G=G, coherence=np.ones(G.shape), random_error=np.full(G.shape, 0.001),
        inputs=TRUTH.inputs, outputs=TRUTH.outputs, input_std=np.ones(2), output_std=np.ones(3),
    )  # fmt: skip
    plain, records = OutputError(domain=domain), [noisy(1)]
    fit = plain.fit(TRUTH, records)
    both = replace(fit, cost=fit.cost + 50.0)  # what they add where they count
    joint = _better_as_steps(replace(plain, responses=[exact]), both, records)
    assert joint == pytest.approx(_better_as_steps(plain, fit, records), abs=0.5)


@pytest.mark.second
@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_prior_values_make_no_steps_likelier(domain):
    plain, records = OutputError(domain=domain), [noisy(1)]
    found = plain.fit(TRUTH, records)["Lp"]
    priors = {"Lp": (found.value + 8 * found.std_error, found.std_error)}
    with pytest.warns(DataWarning, match="prior"):
        fit = replace(plain, priors=priors).fit(TRUTH, records)
    assert ((fit["Lp"].value - priors["Lp"][0]) / priors["Lp"][1]) ** 2 / 2 > 6
    held = [name for name in fit.free_names if name != "Yv"]  # one has to be free
    late = replace(fit.model, tau=fit["tau"].value - T[1] / 2)
    steps = [replace(record, hold="zoh") for record in records]
    lines = plain.fit(fit.model, records, fixed=held, near=fit)
    there = plain.fit(late, steps, fixed=held, near=fit)
    better = _better_as_steps(replace(plain, priors=priors), fit, records)
    assert better == pytest.approx(lines.cost - there.cost, abs=4)  # of one that was free there


def test_its_section_counts_what_was_free_and_warns_of_bounds():
    fit = output_error(TRUTH, noisy(1), bounds={"Lp": (-2.0, 0.0)}, fixed=("tau",))
    other = replace(fit, method="match")
    known = "the records contradict the initial state p = 1 ± 0.1 of flight 1"
    page = SimpleNamespace(
        fits={LABEL: fit, "match": other}, data=(), results={}, warnings=("the input", known)
    )
    (section,) = OUTPUT_ERROR.show(fit, page)
    assert section.lead == "Its 6 free parameters were refined by output error."
    assert section.values["others"] == {"match": other}
    said = " ".join(each.text for each in section.cautions)
    assert "1 parameter lies on a bound: Lp." in said
    assert min(section.cautions, key=lambda each: each.rank).text == known
    assert fit["Lp"].value == pytest.approx(-2.0)


def test_its_section_shows_the_chosen_step_where_one_was_chosen():
    fit = output_error(TRUTH, noisy(1))
    last = replace(fit, method="match")
    page = SimpleNamespace(
        fits={LABEL: fit, CHOSEN: last}, data=(), results={"chosen": last}, warnings=()
    )
    (section,) = OUTPUT_ERROR.show(fit, page)
    assert section.values["found"] is last
    assert section.lead == "Its 7 free parameters are those of the chosen step, match."
    assert section.values["others"] == {LABEL: fit}


@pytest.mark.parametrize(
    ("results", "said"),
    [
        ({}, "look at structure or data"),
        ({"sufficiency": SimpleNamespace(enough=True)}, "look at structure or data"),
        ({"sufficiency": SimpleNamespace(enough=False)}, "the structure leaves dynamics out"),
    ],
)
def test_the_structure_is_blamed_for_coloured_residuals_where_it_is_not_enough(results, said):
    fit = output_error(TRUTH, noisy(1))
    rows = [replace(row, std_error=2 * row.cramer_rao) for row in fit.parameters]
    page = SimpleNamespace(fits={LABEL: fit}, data=(), results=results, warnings=())
    (section,) = OUTPUT_ERROR.show(replace(fit, parameters=tuple(rows)), page)
    assert any(f"correlated in time: {said}" in each.text for each in section.cautions)


def test_a_gain_of_another_shape_is_refused_before_anything_is_estimated():
    settings = OutputError(process_noise=np.eye(5))
    with pytest.raises(ValueError, match=r"\[output_error\].*process_noise has shape \(5, 5\)"):
        OUTPUT_ERROR.check(settings, Task(model=TRUTH))
