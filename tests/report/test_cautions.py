"""The box of cautions: for each a study that must raise it; the sound study must raise none."""

import shutil
from functools import partial

import numpy as np
import pytest
from truths.roll_study import MODEL, TRIM, Truth, write_study

from casid import (
    ConvergenceError,
    Model,
    Record,
    Rows,
    Scalar,
    StateSpace,
    parameter,
    read_study,
    run_study,
    write_csv,
)

BANDS = '[qualification.tolerances]\np = "10 % or 3 deg/s"\nphi = "0.001 deg"\n\n[match]'
RECORDS = '["3211.csv", "sweep.csv"]'
CHOICE = ("[match]", '[choice]\ncandidates = ["time", "quadratic"]\n\n[match]')
PEDALS = [('[channels.units]\nlat = "%"\n', ""), ("noise = true", "noise = false")]
QUIET = [("p = 0.002", "p = 2e-5"), ("phi = 0.002", "phi = 2e-5")]


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


def stick_too_large(t, lat, p, phi):
    return t, str(1.3 * float(lat)), p, phi


def too_large(t, lat, p, phi):
    return t, lat, str(1.5 * float(p)), phi


def unmeasured(t, lat, p, phi):  # noqa: ARG001 - a row
    return t, lat, p, ""


def delayed(name, column, samples):
    """The study's record whose channel was logged too late."""

    def to(folder):
        path = folder / f"{name}.csv"
        header, *rows = path.read_text(encoding="utf-8").splitlines()
        cells = np.array([row.split(",") for row in rows])
        cells[samples:, column] = cells[:-samples, column].copy()
        lines = [",".join(row) for row in cells]
        path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")

    return to


def stalled(folder):
    """The logger of the sweep repeats its last row for 4 s."""
    last = []

    def keep(t, *row):
        last[:] = last if 12 < float(t) < 16 else row
        return t, *last

    changed("sweep", keep)(folder)


def on_the_ground(t, lat, p, phi):
    return (t, lat, "0.01", "-0.02") if 12 < float(t) < 20 else (t, lat, p, phi)


def cut_short(folder):
    """One record is long enough for the black box's kernels, two are not."""
    header, *rows = (folder / "sweep.csv").read_text(encoding="utf-8").splitlines()
    shorter = [row for row in rows if 20 <= float(row.partition(",")[0]) < 25]
    (folder / "third.csv").write_text("\n".join([header, *shorter]) + "\n", encoding="utf-8")
    kept = (folder / "3211.csv").read_text(encoding="utf-8").splitlines()[:200]
    (folder / "3211.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")


def with_pedals(folder, *, moved, feedback=0.0, gust=0.0):
    """Pedals that roll the aircraft too: ``moved(stick, rng)`` less a feedback of the roll rate."""
    more = "Lped: Scalar = parameter(default=1.0, unit='rad/s^2')\n    g: float"
    text = MODEL.replace('("lat",)', '("lat", "ped")').replace("g: float", more)
    text = text.replace("[[0], [self.Llat], [0]]", "[[0, 0], [self.Llat, self.Lped], [0, 0]]")
    (folder / "roll.py").write_text(text, encoding="utf-8")
    rng, flown = np.random.default_rng(5), Truth().system()
    pedal = np.array([[0.0], [3.0], [0.0]])
    A = flown.A - feedback * pedal @ flown.C[:1]
    B = np.hstack([flown.B, pedal, np.array([[0.0], [1.0], [0.0]])])  # stick, pedals, gusts
    names = ("lat", "ped", "gust")
    loop = StateSpace(A, B, flown.C, np.zeros((2, 3)), inputs=names, outputs=flown.outputs)
    for name in ("3211", "sweep", "random"):
        t, percent = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1)[:, :2].T
        stick = percent / 100 - TRIM["lat"]
        own = moved(stick, rng)
        noise = 0.002 * rng.standard_normal((len(t), 2))
        outside = np.column_stack([stick, own - feedback * noise[:, 0]])
        y = loop.simulate(t, np.column_stack([outside, gust * rng.standard_normal(len(t))])) + noise
        u = np.column_stack([stick, own - feedback * y[:, 0]])
        trim = TRIM | {"ped": 0.0}
        write_csv(
            folder / f"{name}.csv", Record(t, u, y, ("lat", "ped"), ("p", "phi"), name, trim=trim)
        )


def flown_anew(folder):
    """A validation record of its own where the study's is needed for the estimation."""
    t = np.arange(0, 30, 0.04)
    u = 0.03 * np.repeat(np.random.default_rng(3).choice([-1.0, 0.0, 1.0], 38), 20)[:750, None]
    y = Truth().system().simulate(t, u)
    new = Record(t, u, y, ("lat",), ("p", "phi"), "new", trim=TRIM)
    write_csv(folder / "new.csv", new)
    changed("new", lambda t, lat, *y: (t, str(100 * float(lat)), *y))(folder)  # [%]


def own_steps(stick, rng):
    """Pedals that are moved by themselves."""
    return 0.04 * np.repeat(rng.choice([-1.0, 0.0, 1.0], len(stick) // 25 + 1), 25)[: len(stick)]


def interconnect(stick, rng):
    """Pedals that follow the stick but for a hundredth of their travel."""
    return -0.5 * stick + 2e-5 * rng.standard_normal(len(stick)).cumsum()


def hardly(stick, rng):
    return 2e-4 * rng.standard_normal(len(stick))


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
         "Output p of the validation records is not judged: it hardly moves beyond its noise"],
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
        ["No output responds to the inputs"],
    ),
    "of sensors that start late": (
        [], None, changed("3211", at_rest),
        ["Kinematics: phi does not follow from the other channels",
         "% of p: vibration, gusts", "The black box has growing modes at"],
    ),
    "held to a band within its noise": (
        [("[match]", BANDS)], None, None,
        ["Out of the tolerance band: phi of random.",
         "Noise alone may leave the tolerance band: phi of random."],
    ),
    "held to a band that nothing leaves": (
        [("[match]", '[qualification.tolerances]\np = "900 deg/s"\n\n[match]')], None, None,
        ["The measurement never leaves the tolerance band around trim in random: passing"],
    ),
    "of records that disagree": (
        [], None, delayed("3211", column=2, samples=5),
        ["Records 3211 and sweep disagree: in 3211 p is 1",
         "ms later than the model of the others predicts, and no third record tells which"],
    ),
    "of three records, one of which disagrees": (
        [(RECORDS, f'{RECORDS[:-1]}, "random.csv"]')], None, changed("3211", too_large),
        ["Record 3211 disagrees with the others: p is 1."],
    ),
    "of a stick of another gain in one record": (
        [(RECORDS, f'{RECORDS[:-1]}, "random.csv"]')], None, changed("3211", stick_too_large),
        ["output error: records contradict each other: 3211 and all others, which agree"],
    ),
    "of one flight twice": (
        [(RECORDS, f'{RECORDS[:-1]}, "copy.csv"]')], None,
        lambda folder: shutil.copy(folder / "sweep.csv", folder / "copy.csv"),
        ["Records sweep and copy are the same flight: it counts twice"],
    ),
    "of a logger that stalled": (
        [("noise = true", "noise = false")], None, stalled,
        ["Record sweep: all channels stand still from 12 s for 3.96 s: the logger stalled"],
    ),
    "of an aircraft on the ground": (
        QUIET, None, changed("sweep", on_the_ground),
        ["sweep: at 14-19.96 s the inputs move but no output does, so"],
    ),
    "of one long record": (
        [(RECORDS, f'{RECORDS[:-1]}, "third.csv"]'), CHOICE,
         ("past = 6", "past = 15"), ("future = 6", "future = 15")], None, cut_short,
        ["Last step quadratic, without sweep failed: ValueError: record '3211' is too short",
         "nothing of record 3211, third is used"],
    ),
    "of inputs flown together": (
        PEDALS, None, partial(with_pedals, moved=interconnect),
        ["rad/s the inputs lat, ped are not moved independently from outside"],
    ),
    "of an input that gusts move by feedback": (
        PEDALS, None, partial(with_pedals, moved=hardly, feedback=1.0, gust=2.0),
        ["Inputs follow the black box's residuals so strongly (noise that a controller",
         "Of input ped only "],
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::casid.DataWarning")  # the box has them
@pytest.mark.parametrize("name", STUDIES)
def test_a_study_raises_the_caution_it_must(name, tmp_path, undrawn):  # noqa: ARG001 - draws nothing
    changes, truth, spoil, cautions = STUDIES[name]
    path = write_study(tmp_path, *changes, truth=truth)
    if spoil:
        spoil(tmp_path)
    told = run_study(read_study(path)).cautions
    said = " ".join(told)
    for caution in cautions:
        assert said.count(caution) == 1
    if name == "of a stick of another gain in one record":
        assert told[0].startswith(cautions[0])  # it spoils all that is estimated
    # A black box of too low an order is no measure of a structure, which is the true one there.
    if name == "of too low an order":
        assert "The structure is not enough" not in said


@pytest.mark.slow
def test_a_sound_study_raises_no_caution_but_that_of_the_bias_it_has(finished):
    (bias,) = finished.cautions
    assert bias.startswith("Kinematics: p has a bias of 0.0")  # the trim that was recorded


SOUND = {  # of what is there, done as it should be
    "inputs flown one at a time": (PEDALS, partial(with_pedals, moved=own_steps)),
    "records without noise": ([("p = 0.002", "p = 0"), ("phi = 0.002", "phi = 0")], None),
    "a choice among three records": (
        [(RECORDS, f'{RECORDS[:-1]}, "random.csv"]'), ('["random.csv"]', '["new.csv"]'), CHOICE],
        flown_anew,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SOUND)
def test_a_study_done_as_it_should_be_raises_no_caution(name, tmp_path, undrawn):  # noqa: ARG001
    changes, add = SOUND[name]
    path = write_study(tmp_path, *changes)
    if add:
        add(tmp_path)
    said = run_study(read_study(path)).cautions
    assert [each for each in said if "p has a bias of 0.01" not in each] == []


@pytest.mark.slow
def test_a_fit_that_is_not_solved_is_no_result(tmp_path, undrawn):  # noqa: ARG001 - draws nothing
    limited = ("[match]", "[output_error.solver]\nmax_iterations = 2\n\n[match]")
    study = read_study(write_study(tmp_path, limited))
    with pytest.raises(ConvergenceError, match="output error: iteration limit reached"):
        run_study(study)
    assert not (study.output / "fit.json").exists()
    assert not (study.output / "report.html").exists()
