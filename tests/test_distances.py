"""Distances in units of errors: silent on the truth, by name on what a structure lacks."""

import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from truths.closed_roll import TRUTH, NoSideslip, campaign, off

from casid import FrequencyResponse, distances, match, pbsid
from casid.distances import _with_errors
from casid.values import decode, encode

BAND = (1.05, 8.4)


@cache
def box(seed):
    return pbsid(campaign(seed, 4), order=6, pole=8.0, past=8, future=8, feedthrough=["ay"])


@cache
def missed():
    return distances(NoSideslip(), box(1), band=BAND)


def measured(factor):
    """The black box's response times a factor, as measured with errors of 2 %."""
    system, omega = box(1).system, np.geomspace(*BAND, 12)
    G = factor * system.response(omega)
    ones = np.ones(G.shape)
    return FrequencyResponse(
        omega=omega, G=G, coherence=0.9 * ones, random_error=0.02 * ones, windows=(6.0,),
        inputs=system.inputs, outputs=system.outputs,
        input_std=ones[0, 0], output_std=ones[0, :, 0],
    )  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_true_structure_is_enough_wherever_the_search_begins(seed):
    found = distances(off(), box(seed), band=BAND)
    assert found.enough
    assert found.sentences() == ()
    # What is left is as large as its errors, less the share that a black box is allowed.
    assert 0.1 < np.mean([row.structure**2 for row in found.rows]) < 1.5


def test_what_a_structure_lacks_is_named_with_its_mode():
    found = missed()
    assert not found.enough
    worst = found.faults[0]
    assert (worst.input, worst.band[0]) == ("lat", pytest.approx(1.05))
    swing = TRUTH.system().poles()
    assert abs(worst.missing.pole - swing[swing.imag > 0][0]) < 0.1
    told = found.sentences()
    assert worst.told() in told[0]
    assert f"the black box has {worst.missing} that it cannot make" in told[0]
    assert all(str(worst.missing) not in sentence for sentence in told[1:])  # once is enough


def test_a_fit_is_judged_with_what_it_holds_fixed():
    # A wrong value held fixed is a structure that is not enough; left free, it is.
    fit = match(off(), box(1), fixed={"Llat"}, norm="quadratic", omega=np.geomspace(*BAND, 20))
    assert not distances(fit, box(1), band=BAND).enough
    assert distances(fit.model, box(1), band=BAND).enough


def test_a_black_box_that_measurements_contradict_is_no_fault_of_the_structure():
    found = distances(NoSideslip(), box(1), measured(1.3), band=BAND)
    assert all(row.doubted for row in found.rows)
    assert any(row.far for row in found.rows)
    assert found.enough
    agreed = distances(NoSideslip(), box(1), measured(1.01), band=BAND)
    assert not any(row.doubted for row in agreed.rows)
    assert [row.fault for row in agreed.rows] == [row.far for row in agreed.rows]


def test_rows_are_pairs_by_octaves_and_survive_being_stored():
    found = missed()
    assert len(found.bands) == 3
    assert list(found.by_pair()) == [(o, i) for o in TRUTH.outputs for i in TRUTH.inputs]
    again = decode(json.loads(json.dumps(encode(found))))
    assert repr(again.rows) == repr(found.rows)
    assert again.to_markdown() == found.to_markdown()
    assert "NoSideslip misses something" in repr(found)
    assert found._repr_html_().count("σ!") == len(found.faults)


@pytest.mark.parametrize(
    ("given", "word"), [({"band": (0.0, 2.0)}, "above 0"), ({"level": 1.0}, "chance")]
)
def test_senseless_bands_and_levels_are_refused(given, word):
    with pytest.raises(ValueError, match=word):
        distances(TRUTH, box(1), **given)


def test_a_mode_of_a_black_box_without_errors_has_none():
    mode = _with_errors(-0.3 + 2j, SimpleNamespace(uncertainty=None))
    assert mode.pole == -0.3 + 2j
    assert np.isnan([mode.real_std, mode.imag_std]).all()
