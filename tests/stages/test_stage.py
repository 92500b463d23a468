"""A stage of an outsider: its table, result and section by one line of registration."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from truths.roll_study import Truth, write_study
from truths.small_record import record

from casid import ConvergenceError, Fit, ModelError, identify, read_study, run_study
from casid.report import Caution, Section
from casid.stages.listing import STAGES
from casid.stages.stage import Stage, Task, compute, run_stages
from casid.studies.study import read_records
from casid.values import storable

RUNS = []


@dataclass(frozen=True, kw_only=True)
class Toy:
    """Its settings: each field a key of the table [toy]."""

    power: float = 2.0
    channels: tuple[str, ...] = ("p",)
    centred: bool = False

    def __post_init__(self) -> None:
        if self.power <= 0:
            raise ValueError(f"power = {self.power}, expected above 0")


@storable
@dataclass(frozen=True, kw_only=True)
class Moments:
    """Its result."""

    values: dict
    gain: float


def run(settings, task):
    """Mean of |y|^power in the records of identification, and the gain of the refined fit."""
    RUNS.append(settings)
    y = {n: np.concatenate([r.channel(n) for r in task.records]) for n in settings.channels}
    values = {name: float(np.mean(np.abs(each) ** settings.power)) for name, each in y.items()}
    return Moments(values=values, gain=task.results["output_error"].model.Llat)


def show(found, _) -> Iterable[Section]:
    yield Section(
        name="toy", title="Moments of the records", place=96,
        template="<p>{% for name, value in found.values.items() %}"
        "{{ name }} {{ value | number(3) }}{% endfor %} in {{ content.title }}</p>",
        values={"found": found}, lead="Moments were taken.", cautions=(Caution("Toys only.", -1),),
    )  # fmt: skip


TOY = Stage(
    name="toy", does="moments of the records", run=run, table="toy", settings=Toy(),
    role=("identification",), needs=("output_error",), structured=True, optional=True, show=show,
)  # fmt: skip


def study(folder, *lines):
    """The small study with the stage's table; its one line of registration."""
    path = write_study(folder, ("[match]", "\n".join([*lines, "", "[match]"])))
    return read_study(path, stages=(*STAGES, TOY))


@pytest.mark.slow
def test_a_stage_of_an_outsider_runs_is_kept_is_resumed_and_is_shown(copy):
    RUNS.clear()
    first = run_study(study(copy, "[toy]", "power = 3", 'channels = ["p", "phi"]'))
    found = first.identification.results["toy"]
    assert [settings.power for settings in RUNS] == [3.0]
    records = read_records(study(copy))["identification"]
    p = np.concatenate([record.channel("p") for record in records])
    assert found.values["p"] == pytest.approx(np.mean(np.abs(p) ** 3), rel=1e-12)
    assert (copy / "out" / "stages" / "toy.json").exists()
    page = first.report.read_text(encoding="utf-8")
    body = re.search(r'<section id="toy">(.*?)</section>', page, flags=re.DOTALL)[1]
    assert "Moments of the records" in body
    assert "in Roll near hover" in body
    assert '<a href="#toy">Moments of the records</a>' in page
    assert "Moments were taken." in page
    assert page.index("Toys only.") < page.index('<section id="parameters">')
    assert "toy.power" in page  # among the settings

    again = run_study(study(copy, "[toy]", "power = 3", 'channels = ["p", "phi"]'))
    assert len(RUNS) == 1
    assert "toy" in [timing.stage for timing in again.timings if timing.kept]
    assert again.identification.results["toy"] == found
    changed = run_study(study(copy, "[toy]", "power = 4"))
    assert len(RUNS) == 2
    kept = [timing.stage for timing in changed.timings if timing.kept]
    assert kept == ["pbsid", "quadratic", "hinf", "output_error"]

    without = run_study(study(copy))
    assert "toy" not in without.identification.results
    assert '<section id="toy">' not in without.report.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (("[toyy]",), "unknown key 'toyy'; did you mean 'toy'"),
        (("[toy]", "powr = 2"), r"\[toy\]: unknown key 'powr'; did you mean 'power'\? Known are"),
        (("[toy]", 'power = "two"'), r"\[toy\]: power = 'two', expected a number"),
        (("[toy]", "centred = 1"), r"\[toy\]: centred = 1, expected True or False"),
        (("[toy]", "channels = 3"), r"\[toy\]: channels = 3, expected texts"),
        (("[toy]", "power = -1"), r"\[toy\]: power = -1, expected above 0"),
        (("[derivid]",), r"\[derivid\] would not be read: it needs records; write \[records.freq"),
        (("[frequency]",), r"\[frequency\] would not be read: it needs records"),
    ],
)
def test_a_table_or_key_that_nobody_reads_is_refused_with_its_neighbours(tmp_path, lines, told):
    with pytest.raises(ValueError, match=told):
        study(tmp_path, *lines)


def test_without_its_registration_the_table_is_refused(tmp_path):
    path = write_study(tmp_path, ("[match]", "[toy]\n[match]"))
    with pytest.raises(ValueError, match=r"unknown key 'toy'; known are study, model"):
        read_study(path)


def test_settings_of_another_kind_are_refused_from_python_too(tmp_path):
    asked = read_study(write_study(tmp_path))
    records = read_records(asked)["identification"]
    with pytest.raises(ValueError, match=r"no stage has a table \[pbsidd\]; did you mean 'pbsid'"):
        identify(asked.model, records, settings={"pbsidd": Toy()})
    with pytest.raises(ValueError, match=r"\[pbsid\] is a Toy, expected Pbsid"):
        identify(asked.model, records, settings={"pbsid": Toy()})


def test_a_stage_that_rests_on_one_that_is_not_there_is_told(tmp_path):
    lost = replace(TOY, needs=("nothing",))
    path = write_study(tmp_path, ("[match]", "[toy]\n[match]"))
    with pytest.raises(ValueError, match="no stage is called 'nothing'") as caught:
        read_study(path, stages=(*STAGES, lost))
    assert not isinstance(caught.value, ModelError)


def test_what_comes_before_a_failure_says_its_doubts_with_it():
    def fails(*_):
        raise ConvergenceError("no point", "best")

    def before(*_):
        return SimpleNamespace(doubts=lambda: ("Order 2 misses a mode.",))

    stages = tuple(Stage(name=run.__name__, does="", run=run) for run in (before, fails))
    with pytest.raises(ConvergenceError, match=r"^no point\n.*\nOrder 2 misses a mode\.$") as told:
        run_stages(Task(model=None, stages=stages))
    assert told.value.best == "best"


def test_fits_of_a_study_have_the_units_of_its_channels_whatever_they_are_fitted_to():
    model, one = Truth(), record()
    fit = Fit(
        model=model, parameters=(), cost=0.0, status="", success=True, iterations=0, seconds=0.0,
        method="derivid", notes=None,
    )  # fmt: skip
    for units in ({"lat": "rad"}, {}):
        task = Task(model=model, roles={"frequency": (replace(one, units=units),)})
        assert compute(Stage(name="", does="", run=lambda *_: fit), None, task).units == units
    assert compute(Stage(name="", does="", run=lambda *_: 3), None, task) == 3
