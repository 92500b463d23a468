"""The stage of the black box."""

import warnings
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from truths.structures import SECOND, black_box
from truths.systems import campaign, innovation_record, unstable_plant

from casid import (
    DataWarning,
    Excitation,
    Model,
    Pbsid,
    Record,
    Rows,
    Scalar,
    StateSpace,
    parameter,
    pbsid,
)
from casid.report.content import contradicted
from casid.stages.black_box import BLACK_BOX
from casid.stages.stage import Task


@pytest.mark.second
def test_the_stage_is_pbsid_with_its_settings():
    own = {"order": 5, "pole": 6.0, "past": 10, "feedthrough": ["z"]}
    records = tuple(campaign())
    task = Task(model=None, records=records)
    found = BLACK_BOX.run(Pbsid(**own), task)
    np.testing.assert_array_equal(found.system.A, pbsid(records, **own).system.A)
    assert found.system.poles()[0].real > 0
    assert unstable_plant().poles()[0].real > 0


@dataclass(frozen=True, eq=False, kw_only=True)
class Preferring(Pbsid):
    """Chooses a black box of samples one of whose modes changes its sign from sample to sample."""

    def fit(self, records):
        if self.transform is not None:
            return super().fit(records)
        found = pbsid(records, order=3, past=6, transform="none", feedthrough=False)
        A = np.diag([-0.5, 0.9, 0.8])
        return replace(found, system=replace(found.system, A=A))


def test_a_structure_is_compared_with_a_black_box_that_has_a_continuous_equivalent():
    _, _, record, _ = innovation_record(seed=1)
    settings = Preferring(order=3, pole=1.0, past=6, feedthrough=False)
    with pytest.raises(ValueError, match=r"pole at -0\.5: it has no continuous equivalent"):
        settings.fit([record]).continuous()
    with pytest.warns(DataWarning, match="predicts these records best, but the discrete model has"):
        found = BLACK_BOX.run(settings, Task(model=None, records=(record,)))
    assert found.system.dt is None


def test_the_shares_of_the_inputs_from_outside_are_shown():
    omega = np.array([1.0, 2.0, 4.0, 8.0])
    lower = np.array([[0.9, 0.2], [0.8, 0.1], [0.7, 0.3], [0.0, 0.4]])
    within = np.array([[1, 1], [1, 1], [1, 1], [0, 0]], dtype=bool)
    shares = Excitation(
        inputs=("lat", "lon"), outputs=("p",), omega=omega, lower=lower, upper=lower + 0.1,
        joint=lower[:, 0], answer=np.ones(1), coherence=np.ones(1), within=within, lags=3,
    )  # fmt: skip
    _, section = BLACK_BOX.show(replace(black_box(SECOND), excitation=shares), SimpleNamespace())
    lat, lon = (row._asdict() for row in section.values["rows"])
    assert (lat["name"], lat["low"], lat["high"]) == ("lat", 1.0, 4.0)
    assert [lat[key] for key in ("share", "most", "least", "at")] == pytest.approx(
        [0.8, 0.9, 0.7, 4]
    )
    assert [lon[key] for key in ("share", "least", "at")] == pytest.approx([0.2, 0.1, 2])
    (drawing,) = section.draw()
    line = drawing.figure.axes[1].lines[0]
    np.testing.assert_array_equal(line.get_ydata(), [0.2, 0.1, 0.3])


def test_the_section_tells_order_records_and_doubts():
    sure = replace(black_box(SECOND), records=("3211", "sweep"))
    doubtful = replace(sure, doubtful=np.array([0.3 + 0j]))
    for box, doubts in ((sure, 0), (doubtful, 1)):
        (section,) = BLACK_BOX.show(box, SimpleNamespace())
        assert section.lead == "A black box of order 2 was identified from 2 records (3211, sweep)."
        assert [each.text for each in section.cautions] == list(box.doubts())
        assert len(section.cautions) == doubts
        assert len(list(section.draw())) == 1


def test_records_without_a_model_speak_against_the_structure():
    sound = black_box(SECOND)
    idle = np.zeros(len(sound.system.outputs))
    for explained, against in ((idle + 0.9, False), (idle, True)):
        sections = list(BLACK_BOX.show(replace(sound, explained=explained), SimpleNamespace()))
        assert contradicted(sections) is against


class Unfelt(Model):
    """A pitch rate and what goes with it."""

    states, inputs, outputs = ("w",), ("lon",), ("q", "nz")
    Zlon: Scalar = parameter(default=0.0, lower=-9.0, upper=9.0, unit="-")

    def A(self) -> Rows:
        return [[-1.0]]

    def B(self) -> Rows:
        return [[1.0]]

    def C(self) -> Rows:
        return [[1.0], [-1.0]]


class Felt(Unfelt):
    """The same with an output that may jump with the stick, to be found from zero on."""

    def D(self) -> Rows:
        return [[0.0], [self.Zlon]]


def test_a_structure_tells_the_stage_which_outputs_jump():
    rng, N = np.random.default_rng(5), 1500
    u = np.sign(np.sin(np.cumsum(rng.uniform(0.02, 0.12, N))))[:, None]
    q = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]).simulate(0.04 * np.arange(N), u)
    y = np.hstack([q, 2 * u - q]) + 0.02 * rng.standard_normal((N, 2))
    record = Record(0.04 * np.arange(N), u, y, ("lon",), ("q", "nz"), "steps")
    settings = Pbsid(order=1, pole=4.0, past=8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        known, unknown = (
            BLACK_BOX.run(settings, Task(model=model, records=(record,))).excitation
            for model in (Felt(), Unfelt())
        )
    assert unknown.doubts()
    assert not known.doubts()
