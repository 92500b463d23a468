"""Delays about whole samples in the frequency domain."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from truths.closed_roll import NOISE, TRUTH, T, excitation, with_response
from truths.felt import Slight, felt
from truths.heave import Heave, heaved
from truths.late_pair import Against, Twice, paired
from truths.structures import LateRoll

import casid.shooting.spectral_delays
from benchmarks.between_samples import BOUNDS, H, flight
from casid import Record, SolverOptions, output_error
from casid.free import free_parameters
from casid.shooting.frequency import search
from casid.shooting.lines import transformed
from casid.shooting.spectral_delays import EDGE, FIRST, heard, likelihood, sides

WHOLE = replace(TRUTH, tau=0.06)  # three samples


def stepped(times, hold="zoh"):
    """Two records of inputs held in steps, so many times the usual noise."""
    rng, found = np.random.default_rng(5), []
    for k in range(2):
        still = np.zeros((len(T), 3))
        u = excitation(T, k)
        record = Record(T, u, still, TRUTH.inputs, TRUTH.outputs, f"record {k}", hold=hold)
        noise = {name: times * std for name, std in NOISE.items()}
        found.append(with_response(record, WHOLE).with_noise(noise, rng))
    return found


def ranges(model, records):
    free = free_parameters(model)
    at = free.names.index("tau")
    found = sides(free, transformed(records), free.guess)
    return [(side.lower[at], side.upper[at]) for side in found]


def test_both_sides_of_a_whole_sample_nearby_are_tried():
    edge = EDGE * 0.02
    expected = [(0.04 + edge, 0.06 - edge), (0.06 + edge, 0.08 - edge)]
    np.testing.assert_allclose(ranges(replace(WHOLE, tau=0.0611), stepped(1, "foh")), expected)
    assert ranges(replace(WHOLE, tau=0.07), stepped(1, "foh")) == []
    (side,) = ranges(replace(WHOLE, tau=0.0), stepped(1, "foh"))
    np.testing.assert_allclose(side, (edge, 0.02 - edge))


def test_where_the_output_jumps_stretches_next_to_the_delays_are_tried_wherever_it_is():
    edge = EDGE * 0.02
    expected = [(h + edge, h + 0.02 - edge) for h in (0.04, 0.06, 0.08)]
    for tau in (0.0611, 0.07):
        np.testing.assert_allclose(ranges(replace(WHOLE, tau=tau), stepped(1)), expected)
    # What is at 0 belongs to neither side.
    expected = [(0.0, 0.0), (edge, 0.02 - edge), (0.02 + edge, 0.04 - edge)]
    np.testing.assert_allclose(ranges(replace(WHOLE, tau=0.0), stepped(1)), expected)


def test_straight_lines_break_only_where_they_act_directly():
    assert len(ranges(WHOLE, stepped(1, "foh"))) == 2  # ay hears the stick at once
    assert ranges(replace(WHOLE, tau=0.05), stepped(1, "foh")) == []


def test_sides_end_at_kinks_of_every_input_that_a_parameter_delays():
    # Samples 20 and 50 ms apart: for τ and 2 τ kinks are at 0, 10, 20, 25, 30, 40, 50, ...
    expected = 1e-3 * np.array([[20, 25], [25, 30], [30, 40]])
    found = ranges(Twice(tau=0.0285), paired(Twice, 0.0285))
    np.testing.assert_allclose(found, expected, atol=1.1 * EDGE * 0.01)
    # For τ and 213 ms - τ at 0, 13, 20, 33, 40, 50, 53, 60, 63, ...
    expected = 1e-3 * np.array([[33, 40], [40, 50], [50, 53]])
    found = ranges(Against(tau=0.045), paired(Against, 0.045))
    np.testing.assert_allclose(found, expected, atol=1.1 * EDGE * 0.01)


@pytest.mark.repeats(1)
@pytest.mark.slow
@pytest.mark.parametrize("times", [0.05, 1.0])
def test_a_delay_of_whole_samples_is_found_in_spite_of_its_kink(times):
    fit = output_error(WHOLE, stepped(times), domain="frequency")
    assert fit.success
    for name in ("tau", "Lp", "Llat"):
        assert abs(fit[name].value - getattr(WHOLE, name)) < 4 * fit[name].std_error
    assert fit["tau"].multiplier == 0.0  # the end of a side is no bound


def test_roundings_of_one_sampling_interval_are_one():
    first, second = stepped(1)
    records = [first, replace(second, t=second.t * (1 + 1e-12))]
    assert len({record.dt for record in records}) == 2
    assert len(ranges(WHOLE, records)) == 3  # the delay's own and the next ones


@pytest.mark.second
def test_a_solve_that_ends_on_a_kink_is_left_for_its_sides_at_once():
    rng, h, N = np.random.default_rng(13), 0.02, 400
    u = np.repeat(rng.choice([-0.1, 0.0, 0.1], size=N // 20), 20)
    keep = np.exp(-3.0 * h)  # p' = -3 p + 12 lat, one sample late, lat held in steps
    p = scipy.signal.lfilter([0.0, 0.0, 4 * (1 - keep)], [1.0, -keep], u)
    y = p + 0.01 * rng.standard_normal(N)
    record = Record(h * np.arange(N), u[:, None], y[:, None], ("lat",), ("p",), hold="zoh")
    steps = []
    options = SolverOptions(progress=lambda told: steps.append(told.iteration))
    start = LateRoll(Lp=-2.0, Llat=8.0, tau=0.05)
    fit = output_error(start, record, domain="frequency", solver=options)
    assert fit.success
    for name, true in (("Lp", -3.0), ("Llat", 12.0), ("tau", h)):
        assert abs(fit[name].value - true) < 4 * fit[name].std_error
    assert max(steps) <= FIRST
    assert steps.count(FIRST) == 1  # the solve that ends on the kink


@pytest.mark.second
@pytest.mark.filterwarnings("ignore:output error in the frequency domain.*few lines")
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_a_start_two_samples_off_passes_all_kinks_on_the_way(hold):
    truth, rng = replace(TRUTH, tau=0.0), np.random.default_rng([78, 3])
    record = flight(truth, hold, 0.0, rng, 120)  # brute force, sticks felt at once
    away = 1 + 0.4 * rng.uniform(-1, 1, len(truth.vector()))
    far = replace(truth.with_vector(truth.vector() * away), tau=2.5 * H)
    fits = [
        output_error(start, record, bounds=BOUNDS, domain="frequency") for start in (truth, far)
    ]
    for fit in fits:
        assert fit["tau"].value == pytest.approx(0.0, abs=0.1 * H)
    # Spectra estimated from either side settle alike but for a hundredth of a standard error.
    assert fits[1].cost == pytest.approx(fits[0].cost, abs=0.1)


@pytest.mark.campaign
@pytest.mark.filterwarnings("ignore:output error in the frequency domain.*few lines")
def test_a_side_that_is_passed_over_has_nothing_better(monkeypatch):
    honest, above = casid.shooting.spectral_delays._no_better, []

    def told(outcome, residuals, start):
        passed = honest(outcome, residuals, start)
        if passed and (start != outcome.lam).any():
            end = search(residuals, start, SolverOptions(), outcome.programme.spectra, outcome)
            above.append(likelihood(end) - likelihood(outcome))
        return passed

    monkeypatch.setattr(casid.shooting.spectral_delays, "_no_better", told)
    output_error(replace(WHOLE, tau=0.09), stepped(1), domain="frequency")
    truth, records = Heave(), heaved(masked=False)
    output_error(replace(truth, tlon=0.05, tcol=0.1 - 0.005), records, domain="frequency")
    assert len(above) > 1
    assert min(above) > 0.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:output error in the frequency domain.*few lines")
def test_no_lines_are_less_likely_than_with_a_jumping_delay_held_at_its_truth():
    truth, records = Heave(), heaved(masked=False)
    held = output_error(truth, records, fixed=("tcol",), domain="frequency")
    fit = output_error(replace(truth, tlon=0.05, tcol=0.1 - 0.005), records, domain="frequency")
    assert fit.success
    assert fit.cost <= held.cost


def test_outputs_jump_with_a_direct_term_that_begins_from_nothing():
    model = replace(Slight().at({"q": 0.0, "e": 0.0}), g=0.0)
    found = heard(free_parameters(model), transformed([felt(Slight, 0.0)]), model.vector())
    assert found.direct.tolist() == [True]
    other = heard(free_parameters(TRUTH), transformed(stepped(1)), TRUTH.vector())
    assert other.direct.tolist() == [True, False]  # the pedals have none
