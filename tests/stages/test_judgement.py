"""What the stage of validation shows."""

import numpy as np
import pytest
from truths.roll_study import Truth

from casid import Record, StateSpace, validate
from casid.report import Content
from casid.report.html import body
from casid.stages.judgement import VALIDATION, Judgement

T = 0.02 * np.arange(1000)
U = np.sin(T)[:, None]


def shown(pole):
    """Sections about a model with that pole, judged on a record it flew with a controller."""
    system = StateSpace([[pole]], [[1.0]], [[1.0]], [[0.0]], inputs=("lat",), outputs=("p",))
    y = np.sin(T + 0.3)[:, None]
    found = validate({"roll": system}, [Record(T, U, y, ("lat",), ("p",), "turn")])
    content = Content(
        title="", model=Truth(), results={}, models={"roll": system}, model_files={},
    )  # fmt: skip
    sections = {each.name: each for each in VALIDATION.show(found, content)}
    return found, content, sections


@pytest.mark.parametrize("pole", [-1.0, 1.5])
def test_a_prediction_is_called_one_in_table_figure_and_box(pole):
    found, content, sections = shown(pole)
    predicted = pole > 0
    assert np.isfinite(found.horizon[0]) == predicted
    told = f"Predicted up to {found.horizon[0]:.3g} s ahead"
    cautions = " ".join(each.text for each in sections["verdicts"].cautions)
    assert (told in cautions) == predicted
    remedy = (
        "Validation records: Predictions of p are worse than their means: this growth is not real"
    )
    ranked = sorted(sections["verdicts"].cautions, key=lambda each: each.rank)
    assert [each.text.startswith(remedy) for each in ranked[:1]] == [True] * predicted
    table = body(sections["verdicts"], content)
    assert (told in table) == predicted
    assert ("initial state and constant biases fitted" in table) != predicted
    assert (told in body(sections["rms"], content)) == predicted
    (history,) = sections["histories"].draw()
    assert ("s ahead, not simulated" in history.caption) == predicted
    (bars,) = sections["rms"].draw()
    assert bars.caption.startswith(f"RMS {'prediction' if predicted else 'simulation'} error")
    white = body(sections["whiteness"], content)
    assert ("do not leave white residuals" in white) == predicted
    assert ("Share within the band" in white) != predicted
    assert len(list(sections["whiteness"].draw())) == (0 if predicted else 1)


@pytest.mark.parametrize("horizon", [-1.0, 0.0, np.nan])
def test_a_horizon_that_is_none_is_refused(horizon):
    with pytest.raises(ValueError, match="expected seconds above 0"):
        Judgement(horizon=horizon)
