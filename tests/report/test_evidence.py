"""What the box of cautions leads with: a study that must raise each, and one that must not."""

import re
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from truths.roll_study import Truth, write_study

from casid import (
    Model,
    NonlinearModel,
    Record,
    Rows,
    Scalar,
    output_error,
    parameter,
    read_study,
    run_study,
    simulate,
    validate,
)
from casid.bands import mode_bands
from casid.report.content import OUTPUT_ERROR, Content, DataFile
from casid.report.evidence import few_data, noise_levels, unexplained_records

MEASURED = (
    ("[records.validation]", "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n"
     "[records.validation]"),
    ("[match]", "[frequency]\nomega = {from = 0.6, to = 5, points = 20}\n\n[derivid]\n\n[match]"),
)  # fmt: skip
ENOUGH = ("order = 3", "order = 5")  # states for the lag, or nothing is judged by the black box
# From the black box and from other starts alike output error ends at this bound of Lp alone.
NARROW = ("[channels.units]", "[model.bounds]\nLp = [-0.3, 0]\n\n[channels.units]")
SPARSE = ("[records.validation]", "[records.refinement]\nfiles = ['3211.csv']\nnoise = true\n"
          "decimate = 10\n\n[records.validation]")  # fmt: skip
LEADS = (
    "The structure is not enough: ",
    "Model and data disagree: the black box predicts the validation records better",
    "Output error and frequency domain differ by more than their errors allow",
    "1 parameter lies on a bound: Lp. ",
    "The frequency-domain fit misses the usual limits: J is",
    "Few data: 150 measurements for 9 unknowns",
)


class Lagged(Model):
    """The roll axis behind a rotor, a lag that the study's structure lacks."""

    states, inputs, outputs = ("v", "p", "phi", "a"), ("lat",), ("p", "phi")
    T: Scalar = parameter(default=1.0, unit="s")

    def A(self) -> Rows:
        lag = -1 / self.T
        return [[-0.12, 0, 9.80665, 0], [-0.06, -2.2, 0, 10], [0, 1, 0, 0], [0, 0, 0, lag]]

    def B(self) -> Rows:
        return [[0], [0], [0], [1 / self.T]]


def cautions(folder, *changes, truth=None):
    """Lines of the box on top of the report."""
    page = run_study(read_study(write_study(folder, *changes, truth=truth))).report
    text = page.read_text(encoding="utf-8")
    box = text.partition('class="cautions"')[2].partition("</ul>")[0]
    return re.findall(r"<li>(.*?)</li>", box, flags=re.DOTALL)


@pytest.mark.filterwarnings("ignore:record .3211.. between the samples:casid.DataWarning")
@pytest.mark.slow
def test_a_structure_that_lacks_a_rotor_leads_the_box_with_what_matters(tmp_path):
    said = cautions(tmp_path, *MEASURED, ENOUGH, NARROW, SPARSE, truth=Lagged())
    assert len(said) > len(LEADS)
    for told, lead in zip(said, LEADS, strict=False):
        assert lead in told


@pytest.mark.slow
def test_the_right_structure_raises_none_of_them(tmp_path):
    said = " ".join(cautions(tmp_path, *MEASURED))
    assert said  # kinematics: the records have a bias
    for lead in LEADS:
        assert lead[:16] not in said


def test_noise_is_what_changes_too_fast_and_not_the_residual():
    t = 0.02 * np.arange(2000)
    rng = np.random.default_rng(2)
    slow = np.column_stack([np.sin(t), np.sin(3 * t)])
    y = slow + rng.standard_normal((2000, 2)) * [0.01, 0.002]
    y[::50, 0] = np.nan
    record = Record(t, np.sin(t)[:, None], y, ("u",), ("a", "b"), "one")
    # 2000 samples, of whose third differences some 300 are independent: 4 %, three sigma.
    np.testing.assert_allclose(noise_levels([record]), [0.01, 0.002], rtol=0.12)
    quiet = replace(record, y=slow, name="two")
    assert noise_levels([quiet])[0] < 1e-4


class Damped(Model):
    states, inputs, outputs = ("p",), ("lat",), ("p",)
    Lp: Scalar = parameter(default=-1.0, unit="1/s")

    def A(self) -> Rows:
        return [[self.Lp]]

    def B(self) -> Rows:
        return [[1]]


@pytest.mark.parametrize(
    ("damping", "error", "said"),
    [
        (-0.1, None, 0),  # a time constant of 10 s, in records of 20 s
        (-0.02, None, 1),
        (-0.02, 0.005, 0),  # the records together tell it well enough
        (-0.02, 0.03, 1),
        (0.0, None, 0),  # an integrator
    ],
)
def test_a_mode_slower_than_the_records_is_named_unless_its_error_is_small(damping, error, said):
    flown = SimpleNamespace(role="identification", samples=1000, seconds=20.0)
    covariance = None if error is None else np.array([[error**2]])
    row = SimpleNamespace(value=damping, lower=-np.inf, upper=np.inf, active=False)
    fit = Estimate(model=Damped(Lp=damping), free_names=("Lp",), covariance=covariance, row=row)
    bands = {} if error is None else {OUTPUT_ERROR: mode_bands(fit)}
    content = SimpleNamespace(data=[flown, flown], delivered=OUTPUT_ERROR, bands=bands, fits={})
    content.linear = content
    texts = [each.text for each in few_data(fit, content)]
    assert len(texts) == said
    for text in texts:
        assert "records of 20 s at most, 40 s together" in text
        assert "time constant 50 s" in text
        assert ("eigenvalue ±150%" in text) == (error is not None)


class Sinking(NonlinearModel):
    """w' = T - c w², in balance with the pole -2 c w; the reference is off it, where w is fast."""

    states, inputs, outputs = ("w",), ("T",), ("w",)

    c: Scalar = parameter(default=0.01, lower=0.001, upper=0.1, unit="1/m")

    def derivatives(self, x, u):
        return [u.T - self.c * x.w**2]

    def reference(self):
        return {"w": 50.0}


def test_slow_modes_of_a_nonlinear_structure_are_those_where_it_was_flown():
    t = 0.1 * np.arange(200)
    u = (0.04 + 0.02 * np.sin(0.5 * t) * (t > 2))[:, None]
    still = Record(t, u, np.zeros((200, 1)), ("T",), ("w",), "slow")
    record = simulate(Sinking(), still, {"w": 2.0}).with_noise(
        {"w": 0.01}, np.random.default_rng(2)
    )
    fit = output_error(Sinking(), record, biases=False)
    vague = replace(fit, covariance=np.array([[0.02**2]]))  # of c, twice its value
    file = DataFile(
        role="identification", name="slow", path="", sha256="", samples=1000, seconds=19.9,
        noise=False,
    )  # fmt: skip
    content = Content(
        title="", model=Sinking(), results={"validation": SimpleNamespace(measured=(record,))},
        models={OUTPUT_ERROR: vague}, model_files={}, data=(file,),
    )  # fmt: skip
    (told,) = (each.text for each in few_data(vague, content))  # and no warning, which would raise
    slow = 1 / (2 * np.sqrt(fit.model.c * 0.04))
    assert slow == pytest.approx(float(re.search(r"time constant ([\d.]+) s", told)[1]), rel=0.02)


@dataclass(frozen=True)
class Estimate:
    """As much of a fit as the modes ask for."""

    model: Model
    free_names: tuple[str, ...]
    covariance: np.ndarray | None
    row: SimpleNamespace

    def __getitem__(self, name):
        return self.row


def judged(late, gust=0.0, process_noise=False):
    """What is told of two validation records of the roll axis, the sticks of one maybe late."""
    rng, t = np.random.default_rng(1), 0.02 * np.arange(1000)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 25), 40)[:, None]
    records = []
    for name, lag in (("own", 0), ("new", 0), ("old", late)):
        stick = np.roll(u, 13 * len(records), axis=0)
        clean = Truth().system().simulate(t, np.roll(stick, -lag, axis=0))
        clean += gust * turned(rng.standard_normal(1000))
        y = clean + 0.003 * rng.standard_normal((1000, 2))
        records.append(Record(t, stick, y, ("lat",), ("p", "phi"), name))
    fit = output_error(Truth(), records[0], process_noise=process_noise)
    models = {"black box": fit.model.system(), "output error": fit}
    found = validate(models, records[1:])
    content = SimpleNamespace(fits={"output error": fit}, delivered="output error")
    return [each.text for each in unexplained_records(found, content)]


def turned(white):
    """Motion (1000, 2) of the roll axis by white accelerations held over the samples."""
    system = Truth().system()
    A, B = scipy.linalg.expm(0.02 * system.A), 0.02 * np.eye(system.nx)[0]
    x = np.zeros((1000, system.nx))
    for k in range(999):
        x[k + 1] = A @ x[k] + B * white[k]
    return x @ system.C.T


@pytest.mark.campaign
def test_turbulence_is_no_other_aircraft():
    assert judged(0, gust=2.0, process_noise=True) == []


@pytest.mark.second
def test_a_validation_record_that_no_model_explains_is_told():
    assert judged(0) == []
    (said,) = judged(8)
    assert said.startswith("Validation record old is not explained as well as the identif")
