"""The box of cautions: for each a study that must raise it; the sound study must raise none."""

import shutil

import numpy as np
import pytest
from truths.roll_study import Truth, write_study

from casid import Model, Rows, Scalar, parameter, read_study, run_study

BANDS = '[qualification.tolerances]\np = "10 % or 3 deg/s"\nphi = "0.001 deg"\n\n[match]'
RECORDS = '["3211.csv", "sweep.csv"]'


class Tilted(Model):
    """The roll axis beside a hardly damped swing of 3 rad/s, which makes most of the motion."""

    states, inputs, outputs = ("v", "p", "phi", "a", "b"), ("lat",), ("p", "phi")
    omega: Scalar = parameter(default=3.0, unit="rad/s")

    def A(self) -> Rows:
        swing = [0, 0, 0, -(self.omega**2), -0.02 * self.omega]
        roll = [[-0.12, 0, 9.80665, 0, 0], [-0.06, -2.2, 0, 8, 0], [0, 1, 0, 0, 0]]
        return [*roll, [0, 0, 0, 0, 1], swing]

    def B(self) -> Rows:
        return [[0], [10], [0], [0], [self.omega**2]]


def changed(name, change):
    """A change of a record's rows (t, lat, p, phi), as text, in the study's folder."""

    def to(folder):
        path = folder / f"{name}.csv"
        header, *rows = path.read_text(encoding="utf-8").splitlines()
        new = [",".join(change(*row.split(","))) for row in rows]
        path.write_text("\n".join([header, *new]) + "\n", encoding="utf-8")

    return to


def flown_by_another(folder):
    """The validation record is of an aircraft whose stick does half as much."""
    other = folder / "other"
    other.mkdir()
    write_study(other, truth=Truth(Llat=5.0))
    shutil.copy(other / "random.csv", folder)


def at_rest(t, lat, p, phi):
    """Logged with sensors that start late."""
    return (t, lat, "0.01", "-0.02") if float(t) < 10 else (t, lat, p, phi)


def without_stick(t, lat, p, phi):  # noqa: ARG001 - a row
    """What noise and drift make while nobody moves the stick."""
    rng = np.random.default_rng(round(100 * float(t)))
    return t, "50", f"{0.01 + 0.002 * rng.standard_normal():.6f}", phi


def unmeasured(t, lat, p, phi):  # noqa: ARG001 - a row
    return t, lat, p, ""


STUDIES = {  # changes of the study, its truth, what is done to its files, cautions
    "validated by a copy": (
        [('["random.csv"]', '["sweep.csv"]')], None, None,
        ["Record sweep is for validation, but an estimation has seen it"],
    ),
    "validated by another aircraft": (
        [], None, flown_by_another, ["Validation record random is not explained as"],
    ),
    "validated at rest": (
        [], None, changed("random", without_stick),
        ["Output phi of the validation records is predicted poorly",
         "), but its error is that of the noise: it hardly moves where it is judged."],
    ),
    "validated without an output": (
        [("[match]", BANDS)], None, changed("random", unmeasured),
        ["Output phi of the validation records is not judged",
         "Not judged by the tolerance bands: phi of random"],
    ),
    "validated by predictions": (
        [("[match]", "[validation]\nhorizon = 3\n\n[match]")], None, None,
        ["Validation records: Predicted up to 3 s ahead"],
    ),
    "held off its optimum": (
        [("[match]", "[model.bounds]\nLlat = [0, 1]\n\n[match]")], None, None,
        ["The structure is not enough: p after lat",
         "Model and data disagree: the black box predicts the validation records better, p",
         "1 parameter lies on a bound: Llat",
         "Residuals are correlated in time: the structure leaves dynamics out",
         "is not determined (standard error above the value): Yv"],
    ),
    "of a slow aircraft": (
        [], Truth(Lv=0.0), None,
        ["Few data: records of 30 s at most, 60 s together, leave slow modes uncertain, spiral",
         "The sign of 1 parameter is not determined (standard error above the value): Lv."],
    ),
    "of few samples": (
        [(RECORDS, f"{RECORDS}\nresample = 0.5")], None, None,
        ["Few data: 240 measurements for 14 unknowns", "Of input lat only "],
    ),
    "of too low an order": ([("order = 3", "order = 2")], None, None, ["Order 2 is too low"]),
    "of a swing that nothing excites enough": (
        [], Tilted(), None, ["These data do not support a model"],
    ),
    "of noise": (
        [("p = 0.002", "p = 0.5"), ("phi = 0.002", "phi = 0.2")], None, None,
        ["No output answers the inputs"],
    ),
    "of sensors that start late": (
        [], None, changed("3211", at_rest),
        ["Kinematics: phi does not follow from the other channels",
         "of p goes with the inputs: vibration", "The black box grows at"],
    ),
    "held to a band within its noise": (
        [("[match]", BANDS)], None, None,
        ["Out of the tolerance band: phi of random.",
         "Noise alone may leave the tolerance band: phi of random."],
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_raises_the_caution_it_must(name, tmp_path, undrawn):  # noqa: ARG001 - draws nothing
    changes, truth, spoil, cautions = STUDIES[name]
    path = write_study(tmp_path, *changes, truth=truth)
    if spoil:
        spoil(tmp_path)
    said = " ".join(run_study(read_study(path)).cautions)
    for caution in cautions:
        assert caution in said
    # A black box of too low an order is no measure of a structure, which is the true one there.
    if name == "of too low an order":
        assert "The structure is not enough" not in said


@pytest.mark.slow
def test_a_sound_study_raises_no_caution_but_that_of_the_bias_it_has(finished):
    (bias,) = finished.cautions
    assert bias.startswith("Kinematics: p has a bias of 0.0")  # the trim that was recorded
