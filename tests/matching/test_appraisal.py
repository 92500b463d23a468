"""Reasons to disbelieve a solver, each against a case that is none."""

import numpy as np
import pytest
from truths.structures import SECOND, TRUTH, HoverRoll, Lag

from casid import Constraint, Rows, Scalar, StateSpace, parameter
from casid.free import free_parameters
from casid.matching.appraisal import _runaway, appraise, doubts, response_size
from casid.matching.targets import comparison_of


class Unbounded(Lag):
    """A lag whose speed has no bounds, and whose gain is at least its speed."""

    a: Scalar = parameter(default=1.0, unit="1/s", scale=1.0)

    def A(self) -> Rows:
        return [[-self.a]]

    def constraints(self):
        return [Constraint("fast enough", self.k - self.a, lower=0.0, upper=np.inf)]


def doubt(values, *, target=SECOND, stable=True):
    free = free_parameters(Unbounded())
    values = np.array(values)
    appraisal = appraise(
        Unbounded().with_vector(values).system(), comparison_of(Unbounded(), [target])
    )
    return doubts(free, values, free.guess, appraisal, stable=stable)


def test_a_sound_solution_raises_no_doubt():
    assert doubt([1.2, 1.3]) is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([2e4, 3e4], "a = 2e+04 runs away"),
        ([2.0, 1.0], "constraint 'fast enough' is -1"),
        ([-3.0, 1.0], "pole at 3"),
    ],
)
def test_each_doubt_names_its_culprit(values, message):
    assert message in doubt(values)


@pytest.mark.parametrize(
    ("bounds", "value", "away"),
    [
        ((-np.inf, 3e4), 2e4, False),
        ((-np.inf, 3e4), -2e4, True),
        ((-3e4, np.inf), 2e4, True),
        ((-3e4, np.inf), -2e4, False),
    ],
)
def test_a_parameter_runs_away_where_it_has_no_bound_on_that_side(bounds, value, away):
    free = free_parameters(Unbounded(), bounds={"a": bounds})
    said = _runaway(free, np.array([value, 1.0]), np.array([1.0, 1.0]))
    assert (said or "").startswith(f"a = {value:.3g} runs away") == away


def test_poles_right_of_the_line_are_no_doubt_where_they_may_be():
    assert "right of the shift" in doubt([-0.9, 1.0])
    assert "right of the shift" not in (doubt([-0.9, 1.0], stable=False) or "")


def test_an_opposite_sign_explains_nothing():
    opposite = StateSpace(SECOND.A, -SECOND.B, SECOND.C, SECOND.D, None, ("u",), ("x",))
    assert "explains nothing of the target; its worst pair is x from u" in doubt(
        [1.2, 1.3], target=opposite
    )


def test_the_peak_is_where_a_dense_grid_has_it():
    comparison = comparison_of(HoverRoll(), [TRUTH.system()], weight=np.array([[1.0], [0.1]]))
    appraisal = appraise(HoverRoll(Lp=-2.0, Llat=8.0).system(), comparison)
    dense = np.geomspace(*comparison.band, 20_001)
    source = comparison.sources[0].at(dense)
    error = source.error(appraisal.system)
    sigma = np.linalg.norm(error, axis=(1, 2))  # one input: the norm of a column
    top = int(np.argmax(sigma))
    assert appraisal.top[1].peak_omega == pytest.approx(dense[top], rel=1e-2)
    assert sigma[top] <= appraisal.upper <= sigma[top] * (1 + 2e-3)
    worst = int(np.argmax(abs(error[top, :, 0])))
    assert appraisal.peak_channels() == (HoverRoll.outputs[worst], "lat")
    notes = appraisal.notes("guess").sources[0]
    squares = np.linalg.norm(comparison.error(appraisal.system)) ** 2
    assert notes.sum_of_squares == pytest.approx(squares)
    assert notes.share == 1.0


def test_the_size_of_the_response_is_its_largest_singular_value():
    comparison = comparison_of(Lag(), [SECOND], shift=0.0)
    gain = np.abs(comparison.W * SECOND.response(comparison.s.imag)).max()
    assert response_size(comparison) == pytest.approx(gain, rel=1e-12)
