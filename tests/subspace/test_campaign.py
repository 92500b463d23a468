"""Records of a campaign, gathered once."""

import numpy as np
import pytest
from truths.systems import campaign, closed_loop_record, unstable_plant

from casid.subspace.campaign import Campaign, Windows

W = Windows(8, 8, 6.0, 0.0)


def test_columns_of_all_records_but_one_are_those_of_the_rest():
    flights = campaign(noise=0.05, records=3, duration=12.0)
    whole = Campaign.of(flights, True)
    left = whole.part([flights[0], flights[2]])
    one, other = whole.stack(8, 6.0, without=(1,)), left.stack(8, 6.0)
    np.testing.assert_allclose(one.R.T @ one.R, other.R.T @ other.R, rtol=1e-9)
    assert one.columns == other.columns < whole.stack(8, 6.0).columns
    np.testing.assert_array_equal(left.su, whole.su)  # the same scales
    grams = [whole.part([each]).stack(8, 6.0).R for each in flights]
    total = whole.stack(8, 6.0).R
    np.testing.assert_allclose(total.T @ total, sum(R.T @ R for R in grams), rtol=1e-9)


def test_scales_are_the_standard_deviations_of_all_samples():
    flights = campaign(records=2, duration=12.0)
    found = Campaign.of(flights, False)
    np.testing.assert_allclose(found.sy, np.std(np.vstack([each.y for each in flights]), axis=0))
    assert not found.mask.any()
    np.testing.assert_array_equal(
        Campaign.of(flights, ["z"]).mask, [[False, False], [False, False], [True, True]]
    )


def test_short_gaps_are_filled_and_long_ones_cut():
    record = campaign(records=1, duration=12.0)[0]
    record.y.flags.writeable = True
    y = record.y.copy()
    y[100:102] = np.nan
    y[300:400] = np.nan
    holed = Campaign.of(type(record)(record.t, record.u, y, record.inputs, record.outputs), True)
    pieces = holed.pieces(6.0)
    assert len(pieces) == 2
    assert all(np.isfinite(piece.y).all() for piece in pieces)
    assert pieces[0].t[-1] < record.t[300]
    assert pieces[1].t[0] > record.t[399]


def test_records_too_short_for_their_windows_are_refused_by_name():
    short = closed_loop_record(
        unstable_plant(), np.random.default_rng(0), duration=2.0, name="short"
    )
    unknowns = W.past * (short.nu + short.ny) + short.nu
    said = rf"record 'short' is too short: .* for {unknowns} unknowns .* longest record 2 s"
    with pytest.raises(ValueError, match=said):
        Campaign.of(short, True).subspace(5, W)


def test_a_band_ends_where_inputs_or_projections_do():
    found = Campaign.of(campaign(records=1, duration=12.0), True)
    low, high = found.band(6.0)
    assert 0 < low < high
    assert found.band(1e4) == found.band(np.nan)  # then the inputs decide
    assert found.band(0.5)[1] < high
