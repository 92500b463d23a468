"""A record that contradicts the others: found in flights, and seldom told by chance."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from truths.banked import told
from truths.structures import Banking

from casid import DataWarning, Record, output_error
from casid.shooting.amplitudes import Sides
from casid.shooting.hausman import Disagreement
from casid.shooting.homogeneity import OPPOSED, tell
from casid.shooting.outlying_records import Discord, Heterogeneity

T = np.arange(0, 6, 0.05)


def flown(count, seed):
    """Records of Lp = -4, Llat = 10."""
    rng = np.random.default_rng(seed)
    system = [[-4.0, 0.0], [1.0, 0.0]], [[10.0], [0.0]], np.eye(2), np.zeros((2, 1))
    made = []
    for k in range(count):
        u = 0.2 * np.sign(np.sin((1.5 + 0.5 * k) * T)) * (T > 0.5)
        y = lsim(system, u, T)[1] + rng.standard_normal((len(T), 2)) * [0.03, 0.01]
        made.append(Record(T, u[:, None], y, Banking.inputs, Banking.outputs, f"flight {k}"))
    return made


@pytest.mark.second
def test_a_stick_of_another_gain_is_told_with_what_its_record_moves():
    records = flown(4, seed=1)
    records[2] = replace(records[2], u=1.3 * records[2].u)
    fit, (said,) = told(records)
    assert ": flight 2 and all others, which agree (chi-square of" in said
    assert "biases or state_biases allow for constant offsets; leave it out" in said
    without, nothing = told([each for each in records if each.name != "flight 2"])
    assert nothing == []
    # By noise alone: as known without it, and a little better for as many records more.
    noise = without["Llat"].cramer_rao * np.sqrt(3 / 4)
    moved = (without.model.Llat - fit.model.Llat) / noise
    stated = float(said.partition("Llat by ")[2].split(";")[0].split(",")[0])
    assert moved == pytest.approx(stated, rel=0.2)  # to first order


def test_true_flights_are_not_told():
    records = flown(3, seed=2)
    assert told(records)[1] == told(records, biases=False)[1] == []


@pytest.mark.second
def test_what_is_known_before_and_wrong_sets_no_two_flights_against_each_other():
    with pytest.warns(DataWarning, match="Lp"):  # it is told of the prior
        output_error(Banking(), flown(2, seed=3), priors={"Lp": (-6.0, 0.05)})
    assert told(flown(2, seed=3), priors={"Lp": (-6.0, 0.05)})[1] == []


@pytest.mark.second
@pytest.mark.parametrize("seed", [4, 5, 6])
def test_scattered_records_do_not_hide_the_one_at_fault_in_large_standard_errors(seed):
    records = flown(6, seed)
    records[0] = replace(records[0], u=1.15 * records[0].u)
    _, (said,) = told(records)
    assert ": flight 0 and all others, which agree" in said


def sentence(sizes, which, any_=False, far=5.0):
    """What is told of records with steps of one or two sticks."""
    u = [np.outer(np.sin(T), size) for size in sizes]
    names = [f"stick {k}" for k in range(len(sizes[0]))]
    flights = [Record(T, x, x[:, :1], names, ["p"], f"r{k}") for k, x in enumerate(u)]
    off = Disagreement(100.0, 1, np.array([far]), np.array([far]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataWarning)
        tell(Discord(which, any_, off, np.ones(1)), flights, ["Lp"])
    return "".join(str(each.message) for each in caught)


@pytest.mark.parametrize(
    ("sizes", "which", "end"),
    [
        ([[1], [2], [1.5]], (1,), "r1 has the largest inputs"),
        ([[1], [2], [1.5]], (0,), "r0 has the smallest inputs"),
        ([[1], [2], [1.5]], (2, 0), "r0 has the smallest inputs"),
        ([[1], [2], [1.5]], (2,), ""),
        ([[1], [1.1], [1]], (1,), ""),  # all of one size
        ([[0], [1], [1]], (0,), ""),  # flown with nothing
        ([[0, 1], [2, 0], [1, 0]], (0,), ""),  # alone on its axis
        ([[1, 1], [2, 0], [1, 0]], (0,), ""),  # more than half of what it moves is
        ([[0, 3], [2, 0], [1, 0]], (2,), "r2 has the smallest inputs"),
    ],
)
def test_a_record_of_the_largest_or_smallest_inputs_may_be_no_fault_of_instruments(
    sizes, which, end
):
    said = sentence(sizes, which)
    assert said.startswith(OPPOSED)
    assert ("a response that depends on amplitude looks the same (ask distortion)" in said) == (
        end != ""
    )
    assert end in said


def test_where_no_few_are_to_blame_no_instrument_is():
    said = sentence([[1], [1], [1]], (2,), None)
    assert "r2 most, but also the others, whichever few are left out (chi-square" in said
    assert "Estimates without r2 differ, in standard errors from noise alone: Lp by" in said
    assert "ask distortion" in said
    assert "offset" not in said
    assert sentence([[1], [1], [1]], (2,), None, far=1.0) == ""  # that moves nothing


def test_coloured_noise_that_is_fed_back_is_suspected_before_any_record():
    flights = [Record(T, T[:, None], T[:, None], ["u"], ["p"], f"r{k}") for k in range(3)]
    off = Disagreement(100.0, 1, np.array([3.0]), np.array([3.0]))
    found = Discord((1,), False, off, np.ones(1))
    with pytest.warns(DataWarning, match="Coloured residuals that later inputs follow") as caught:
        tell(found, flights, ["Lp"], fed_back=True)
    assert "Check there" not in str(caught[0].message)
    with pytest.warns(DataWarning, match="Check there the offset") as caught:
        tell(found, flights, ["Lp"])
    assert "Coloured" not in str(caught[0].message)


def test_by_how_much_errors_are_those_of_scatter_is_told_whatever_an_estimate_moves():
    flights = [Record(T, T[:, None], T[:, None], ["u"], ["p"], f"r{k}") for k in range(4)]
    off = Disagreement(100.0, 1, np.array([1.0]), np.array([1.0]))
    found = Discord((2, 3), None, off, np.ones(1), wider=np.array([2.4]))
    with pytest.warns(DataWarning, match="larger: that of Lp is 2.4 times") as caught:
        tell(found._replace(sides=Sides((0, 1), (2, 3))), flights, ["Lp"])
    assert "larger inputs, r2, r3, and those of the smaller, r0, r1 (" in str(caught[0].message)
    with pytest.warns(DataWarning, match=r"\(chi-square of 80 in 3 combinations .* of all records"):
        tell(found._replace(whole=Heterogeneity(80.0, 3)), flights, ["Lp"])
    with pytest.warns(DataWarning, match=": r1 and r0 .*flight condition") as caught:
        tell(found._replace(which=(1,), wider=np.array([1.1])), flights[:2], ["Lp"])
    assert "scatter between records" not in str(caught[0].message)
