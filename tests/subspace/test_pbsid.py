import warnings
from contextlib import nullcontext
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from truths.systems import (
    OMEGA,
    campaign,
    closed_loop_record,
    relative_error,
    stepped_input,
    unstable_plant,
)

from casid import DataWarning, Record, StateSpace, pbsid
from casid.records import standard_deviations
from casid.subspace.columns import gather
from casid.subspace.fourier import spectra
from casid.subspace.pbsid import Pbsid
from casid.subspace.refinement import refine
from casid.subspace.refinement_choice import refine_projected


@pytest.mark.second
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_noise_free_unstable_plant_in_closed_loop_is_recovered(hold):
    plant = unstable_plant()
    box = pbsid(campaign(hold=hold), order=5, past=10, pole=6.0, feedthrough=["z"])
    # The likelihood is exact for held inputs: 1e-4 is where its Gauss-Newton steps settle.
    assert relative_error(box.system, plant) < 1e-4
    found = box.system.poles()
    for pole in plant.poles():
        assert np.min(np.abs(found - pole)) < 1e-3 * max(abs(pole), 1)


def test_masked_direct_term_is_zero_in_continuous_time_and_the_free_one_is_found():
    box = pbsid(campaign(noise=0.01), order=5, past=10, pole=6.0, feedthrough=["z"])
    np.testing.assert_array_equal(box.system.D[:2], 0.0)
    assert box.system.D[2, 0] == pytest.approx(0.3, abs=0.02)


@pytest.mark.second
def test_settings_chosen_for_one_campaign_serve_another():
    asked = Pbsid(feedthrough=["z"])
    chosen = asked.fit(campaign(noise=0.01))
    given = asked.like(chosen)
    assert given.feedthrough == ["z"]
    other = given.fit(campaign(noise=0.02))
    assert (other.selection, other.pole, other.past) == (None, chosen.pole, chosen.past)
    assert other.system.A.shape == chosen.system.A.shape
    again = given.fit(campaign(noise=0.01))
    np.testing.assert_array_equal(again.system.A, chosen.system.A)
    assert asked.like(replace(chosen, transform="none")) is asked


def test_samples_themselves_give_the_discrete_model_exactly():
    rng = np.random.default_rng(3)
    A = np.array([[0.8, 0.3, 0], [-0.3, 0.8, 0.1], [0, 0, 0.5]])
    B, C = np.array([[1.0], [0.5], [1.0]]), np.array([[1.0, 0, 0.3], [0, 1.0, 0]])
    truth = StateSpace(A, B, C, np.zeros((2, 1)), 0.1)
    t = 0.1 * np.arange(400)
    u = stepped_input(400, 1, rng, hold=3)
    record = Record(t, u, truth.simulate(t, u), ("u1",), ("y1", "y2"), hold="zoh")
    box = pbsid([record], order=3, past=8, feedthrough=False, transform="none", regularisation=0.0)
    assert box.system.dt == pytest.approx(0.1)
    assert relative_error(box.system, truth, np.linspace(0.2, 25, 20)) < 1e-8
    continuous = box.continuous()
    assert continuous.system.dt is None
    # The continuous model's zero-order-hold response at the samples is the discrete one's.
    again = continuous.system.simulate(t, u, hold="zoh")
    np.testing.assert_allclose(again, record.y, atol=1e-7)


def test_all_records_count_not_only_the_last():
    records = campaign(noise=0.05, records=4, duration=12.0)
    plant = unstable_plant()
    joint = pbsid(records, order=5, past=8, pole=6.0, feedthrough=["z"])
    last = pbsid(records[-1:], order=5, past=8, pole=6.0, feedthrough=["z"])
    median = lambda system: np.median(  # noqa: E731
        np.abs(system.response(OMEGA) / plant.response(OMEGA) - 1)
    )
    assert median(joint.system) < median(last.system)
    assert [segment.record for segment in joint.segments] == ["r0", "r1", "r2", "r3"]


def test_order_of_records_does_not_matter():
    records = campaign(noise=0.02, records=3, duration=12.0)
    one = pbsid(records, order=5, past=8, pole=6.0)
    other = pbsid(records[::-1], order=5, past=8, pole=6.0)
    np.testing.assert_allclose(
        one.system.response(OMEGA), other.system.response(OMEGA), rtol=1e-6, atol=1e-8
    )


def test_units_of_channels_do_not_matter():
    records = campaign(noise=0.02)
    scaled = [Record(r.t, 100 * r.u, 57.3 * r.y, r.inputs, r.outputs, r.name) for r in records]
    one = pbsid(records, order=5, past=8, pole=6.0)
    other = pbsid(scaled, order=5, past=8, pole=6.0)
    np.testing.assert_allclose(
        other.system.response(OMEGA), 0.573 * one.system.response(OMEGA), rtol=1e-6
    )


def test_gain_stabilises_the_predictor():
    for refined in (False, True):
        box = pbsid(campaign(noise=0.05), order=5, past=8, pole=6.0, refine=refined)
        assert np.linalg.eigvals(box.system.A - box.K @ box.system.C).real.max() < 0


@pytest.mark.second
def test_missing_samples_are_interpolated_over_short_gaps_and_split_long_ones():
    records = campaign(noise=0.001, duration=40.0)
    y = records[0].y.copy()
    y[100, 0] = np.nan  # short
    y[900:1000, 1] = np.nan  # 2 s
    gappy = Record(records[0].t, records[0].u, y, records[0].inputs, records[0].outputs, "gappy")
    box = pbsid([gappy, records[1]], order=5, past=8, pole=6.0, feedthrough=["z"])
    parts = [segment for segment in box.segments if segment.record == "gappy"]
    assert len(parts) == 2
    assert sum(segment.interpolated for segment in parts) == 1
    assert relative_error(box.system, unstable_plant()) < 0.02


@pytest.mark.second
def test_random_sampling_instants_need_no_resampling():
    plant, rng = unstable_plant(), np.random.default_rng(5)
    stable = StateSpace(
        plant.A - 0.6 * np.eye(5), plant.B, plant.C, plant.D, None, plant.inputs, plant.outputs
    )
    records = []
    for i in range(3):
        t = np.cumsum(rng.uniform(0.01, 0.03, 1000))
        u = np.array([np.sin(t * w + i) for w in (0.7, 1.9, 4.1)]).sum(axis=0)
        v = np.array([np.cos(t * w - i) for w in (0.5, 2.3, 5.3)]).sum(axis=0)
        u = np.column_stack([u, v]) + stepped_input(1000, 2, rng, hold=40)
        records.append(Record(t, u, stable.simulate(t, u), plant.inputs, plant.outputs, f"r{i}"))
    box = pbsid(records, order=5, past=10, pole=6.0, feedthrough=["z"])
    assert relative_error(box.system, stable) < 5e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": 0, "past": 8, "pole": 6.0}, "order = 0, expected at least 1"),
        ({"order": 40, "past": 8, "pole": 6.0}, "order 40 needs past and future of at least 14"),
        ({"order": 5, "transform": "none", "past": 1}, "past = 1, expected at least 2"),
        ({"order": 5, "pole": 6.0, "transform": "none"}, "pole=6 belongs to Laguerre functions"),
        ({"order": 5, "refine": "linear"}, "refine = 'linear', expected True or False"),
        ({"order": 5, "pole": -1.0}, "expected a Laguerre pole > 0"),
        ({"order": 5, "transform": "fourier"}, 'expected "laguerre" or "none"'),
    ],
)
def test_impossible_settings_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        pbsid(campaign(duration=4.0), **options)


@pytest.mark.parametrize(
    ("asked", "most"),
    [({"pole": 6.0}, 12), ({"transform": "laguerre"}, 12), ({}, 12), ({"past": 9, "pole": 6.0}, 9)],
)
def test_an_order_that_no_window_allows_is_refused_by_name_before_any_fit(asked, most):
    flown = campaign()  # sampled much faster than its input moves
    ny = flown[0].ny
    Pbsid(order=most * ny, **asked).check_lengths(flown)
    above = Pbsid(order=most * ny + 1, **asked)
    with pytest.raises(ValueError, match=rf"order = {most * ny + 1} is above the {most * ny} "):
        above.check_lengths(flown)
    with pytest.raises(ValueError, match="order"):
        above.fit(flown)
    Pbsid(order=most * ny + 1, transform="none").check_lengths(flown)
    # Inputs that move as fast as samples come let a model of these take its place.
    rng = np.random.default_rng(1)
    fast = [replace(each, u=rng.standard_normal(each.u.shape), hold="zoh") for each in flown]
    expected = pytest.raises(ValueError, match="is above the") if asked else nullcontext()
    with expected:
        above.check_lengths(fast)


def test_a_record_shorter_than_the_kernels_is_refused_by_name():
    with pytest.raises(ValueError, match=r"record 'r0' is too short.*raise the pole"):
        pbsid(campaign(records=1, duration=2.0), order=5, past=10, pole=6.0)


def test_uneven_samples_are_refused_without_a_transform():
    record = campaign(records=1)[0]
    t = record.t.copy()
    t[5:] += 0.01
    uneven = Record(t, record.u, record.y, record.inputs, record.outputs, "uneven")
    with pytest.raises(ValueError, match="'uneven' is not equidistant"):
        pbsid([uneven], order=5, transform="none")


def test_samples_of_two_intervals_or_holds_are_refused_by_name():
    one, other = campaign()
    held = replace(other, hold="zoh")
    for wrong in (other.decimate(2), held):
        with pytest.raises(ValueError, match=r"'r0' and 'r1' are sampled every 0.02.*resample"):
            pbsid([one, wrong], order=5, transform="none")


def test_records_of_two_intervals_are_one_campaign_of_projections():
    one, other = campaign(noise=0.001, duration=40.0)
    box = pbsid([one, other.decimate(2)], order=5, past=10, pole=6.0, feedthrough=["z"])
    # Straight lines over two samples miss what the faster ones show: half a per cent of the input.
    assert relative_error(box.system, unstable_plant()) < 0.05


@pytest.mark.parametrize("letter", ["u", "y"])
def test_dependent_channels_are_named(letter):
    records = campaign(noise=0.0)
    kind, names = ("inputs", ("a", "b", "again")) if letter == "u" else ("outputs", None)
    names = names or ("x", "y", "z", "again")
    twice = []
    for record in records:
        values = getattr(record, letter)
        more = np.column_stack([values, 2 * values[:, 0] - values[:, 1]])
        twice.append(replace(record, **{letter: more, kind: names}))
    one, other = names[:2]
    with pytest.raises(ValueError, match=f"{kind} {one} and {other} and again depend on one"):
        pbsid(twice, order=5, past=8, pole=6.0)


@pytest.mark.parametrize("settings", [{"pole": 6.0}, {"transform": "none"}])
def test_a_dead_output_is_named(settings):
    records = [replace(record, y=record.y * [1, 0, 1] + 0.1) for record in campaign()]
    with pytest.raises(ValueError, match=f"'{records[0].outputs[1]}' never moves in any record"):
        pbsid(records, order=5, past=8, **settings)


def test_a_pole_faster_than_the_samples_is_refused():
    for settings in ({"order": 5, "past": 8}, {}):
        with pytest.raises(ValueError, match=r"every 0\.02 s show nothing"):
            pbsid(campaign(), pole=1e6, **settings)


@pytest.mark.second
def test_short_losses_do_little_harm():
    plant = unstable_plant()
    errors = {True: [], False: []}
    for seed in range(3):
        clean = campaign(noise=0.02, records=3, duration=30.0, seed=seed)
        lossy = []
        for record in clean:
            y = record.y.copy()
            y[np.arange(record.N) % 100 < 4] = np.nan  # four samples every two seconds
            lossy.append(replace(record, y=y))
        for whole, records in ((True, clean), (False, lossy)):
            box = pbsid(records, order=5, past=10, pole=8.0, feedthrough=["z"])
            G, found = plant.response(OMEGA), box.system.response(OMEGA)
            errors[whole].append(np.linalg.norm(found - G) / np.linalg.norm(G))
    assert np.mean(errors[False]) < 1.15 * np.mean(errors[True])


def test_outputs_of_a_slower_instrument_need_no_word():
    records = []
    for record in campaign(noise=0.01, records=2, duration=30.0, dt=0.01):
        y = record.y.copy()
        y[np.arange(record.N) % 4 != 0, 0] = np.nan  # 25 Hz among 100 Hz
        records.append(replace(record, y=y))
    box = pbsid(records, order=5, past=10, pole=8.0, feedthrough=["z"])
    assert relative_error(box.system, unstable_plant()) < 0.1


@pytest.mark.second
def test_a_record_of_which_nothing_is_used_is_named():
    records = campaign(noise=0.01, duration=40.0)
    y = records[1].y.copy()
    y[np.arange(len(y)) % 100 < 40] = np.nan
    with pytest.warns(DataWarning, match="nothing of record r1 is used"):
        pbsid([records[0], replace(records[1], y=y)], order=5, past=8, pole=6.0)


@pytest.mark.second
def test_an_unstable_pole_near_the_laguerre_pole_warns():
    fast = StateSpace([[1.5]], [[1.0]], [[1.0]], [[0.0]])
    rng = np.random.default_rng(0)
    loops = [closed_loop_record(fast, rng, gain=np.array([[3.0]]), name=f"f{i}") for i in range(2)]
    with pytest.warns(DataWarning, match="raise pole"):
        pbsid(loops, order=1, past=4, pole=2.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataWarning)
        pbsid(loops, order=1, past=4, pole=4.0)


@pytest.mark.second
def test_settings_are_a_value_that_fits_what_the_function_fits():
    settings = Pbsid(order=5, past=8, pole=6.0, feedthrough=["z"])
    one, other = settings.fit(campaign()), pbsid(campaign(), **vars(settings))
    np.testing.assert_array_equal(one.system.A, other.system.A)
    with pytest.raises(FrozenInstanceError):
        settings.order = 4


def test_a_choice_gathers_no_record_twice_with_the_same_windows(monkeypatch):
    seen = []

    def counted(records, su, sy, past, a, complete):
        seen.extend((record.name, past, a) for record in records)
        return gather(records, su, sy, past, a, complete)

    monkeypatch.setattr("casid.subspace.columns.gather", counted)
    box = pbsid(campaign(noise=0.02, records=3), order=5, feedthrough=["z"])
    assert box.selection is not None
    assert ("r0", box.past, box.pole) in seen
    assert len(seen) == len(set(seen))


def test_straight_lines_between_samples_are_undone_in_continuous_time():
    plant, rng = unstable_plant(), np.random.default_rng(1)
    stable = replace(plant, A=plant.A - 0.6 * np.eye(5))
    t, u = 0.1 * np.arange(600), rng.standard_normal((600, 2))
    record = Record(t, u, stable.simulate(t, u), plant.inputs, plant.outputs)
    box = pbsid(record, order=5, transform="none", regularisation=0.0)
    assert relative_error(box.continuous().system, stable) < 1e-6


def test_refinement_does_not_turn_a_decaying_mode_into_a_growing_one():
    # With free end states a pole at +0.5 explains these data; the start says the mode decays.
    plant = StateSpace([[0.5, 0.0], [0.0, -3.0]], [[1.0], [3.0]], [[1.0, 1.0]], [[0.0]])
    rng = np.random.default_rng(2)
    record = closed_loop_record(plant, rng, duration=20.0, noise=0.01, gain=np.array([[2.0]]))
    su, sy = standard_deviations([record])
    start = StateSpace([[-0.5, 0.0], [0.0, -3.0]], plant.B, plant.C, plant.D)
    refined, _ = refine(start, spectra([record], su, sy, 15.0), su, sy, np.zeros((1, 1), bool))
    assert refined.poles().real.max() <= 2 / record.duration + 1e-9


def test_a_black_box_knows_its_sampling_and_whether_feedback_biases_it(monkeypatch):
    records = campaign(noise=0.01)
    settings = Pbsid(order=5, past=10, pole=6.0, feedthrough=["z"])
    plain = settings.fit(records)
    assert plain.interval == pytest.approx(records[0].dt)
    assert not plain.biased
    place = "casid.subspace.pbsid.refine_projected"
    monkeypatch.setattr(place, lambda *a, **k: replace(refine_projected(*a, **k), remark="Biased."))
    doubted = settings.fit(records)
    assert doubted.biased
    assert doubted.remarks == (*plain.remarks, "Biased.")
    assert not doubted.measures
