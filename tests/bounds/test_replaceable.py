"""Which manoeuvres may be left out, by inputs that are moved where is known."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, campaign

from casid import ConvergenceError, DataWarning, compare_structures, output_error
from casid.bounds.replaceable import needed, parts_of, told_by, told_unmoved, unmoved

FLOWN = campaign(1, 4)
INPUTS = TRUTH.inputs


def moving(*reaches, records=FLOWN):
    """Records whose sticks reach as far as said, one pair a record."""
    made = []
    for (lat, ped), record in zip(reaches, records, strict=False):
        u = record.u / np.ptp(record.u, axis=0) * np.array([lat, ped])
        made.append(replace(record, u=u))
    return made


def test_a_manoeuvre_that_alone_moves_an_input_is_not_left_out():
    records = moving((1, 0), (0.02, 1), (1, 0), (1, 0.03))  # hands are never quite still
    names = [each.name for each in records]
    assert unmoved(records, names[1:2], INPUTS) == ("ped",)
    assert unmoved(records, names[:1], INPUTS) == ()
    assert unmoved(records, [names[0], names[2], names[3]], INPUTS) == ("lat",)
    assert told_unmoved(records, INPUTS) == f"without {names[1]} nothing moves ped"
    with pytest.warns(DataWarning, match="nothing moves ped: manoeuvres that nothing replaces"):
        assert parts_of(None, records, INPUTS) == [(0,), (2,), (3,)]
    with pytest.raises(ValueError, match=f"groups: without {names[1]} nothing moves ped, so a"):
        parts_of([names[:1], names[1:2]], records, INPUTS)
    with pytest.raises(ValueError, match="without record 0 nothing moves lat; without record 1"):
        parts_of(None, moving((1, 0), (0, 1), (0, 0)), INPUTS)


def test_no_manoeuvre_is_held_for_an_input_that_none_moves_or_all_do():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for reaches in ([(1, 0)] * 3, [(1, 1), (0.3, 0.2), (0.1, 1)]):
            assert len(parts_of(None, moving(*reaches), INPUTS)) == 3


@pytest.mark.second
def test_parameters_of_inputs_are_those_that_an_estimate_without_them_lacks():
    (record,) = moving((1, 0), records=FLOWN[:1])
    assert told_by(TRUTH, ["ped"]) == ["Lped"]
    assert set(told_by(TRUTH, ["lat"])) == {"Ylat", "Llat", "tau"}
    assert needed(TRUTH) == ["lat", "ped"]
    assert needed(TRUTH, fixed=["Lped"]) == ["lat"]
    with pytest.raises(ConvergenceError, match="the records do not determine Lped here"):
        output_error(TRUTH, record)
    assert output_error(TRUTH, record, fixed=["Lped"]).success


def test_manoeuvres_are_left_out_one_by_one_or_in_two_groups_or_more():
    names = [record.name for record in FLOWN]
    assert parts_of(None, FLOWN, INPUTS) == [(i,) for i in range(len(FLOWN))]
    assert parts_of([names[:2], names[2:]], FLOWN, INPUTS) == [(0, 1), (2, 3)]
    for groups in ([names[:2]], [names[:2], []], [names[:2], names]):
        with pytest.raises(ValueError, match="expected two or more, none of them empty or of all"):
            parts_of(groups, FLOWN, INPUTS)
    with pytest.raises(ValueError, match="in two of them"):
        parts_of([names[:2], names[1:3]], FLOWN, INPUTS)
    with pytest.raises(ValueError, match="no manoeuvre is called 'x'"):
        parts_of([names[:2], ["x"]], FLOWN, INPUTS)


def test_a_comparison_that_could_leave_out_nothing_is_refused_before_any_fit():
    with pytest.raises(ValueError, match="without record 1 nothing moves ped; fly each axis twice"):
        compare_structures({"a": TRUTH}, moving((1, 0), (0, 1), (0, 0)))
