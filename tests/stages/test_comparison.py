"""Comparisons of bounds by every estimator, from the command line, and drawn."""

import csv

import numpy as np
import pytest
from click.testing import CliRunner
from truths.mixture import Inline, Mixture, record
from truths.roll_study import write_study
from truths.structures import black_box

from casid import (
    Chain,
    Derivid,
    Execution,
    FrequencyResponse,
    Match,
    OutputError,
    StateSpace,
    compare_bounds,
)
from casid.cli import main
from casid.stages.black_box import Pbsid
from casid.stages.matching import Matching

OMEGA = np.geomspace(0.2, 8.0, 25)
OTHER = StateSpace([[-2.0, 1.0], [0.0, -0.7]], [[1.0], [1.0]], [[1.5, 0.4]], [[0.05]],
                   inputs=("u",), outputs=("y",))  # fmt: skip
HERE = Execution(executor=Inline())
TARGET = black_box(OTHER, (0.2, 8.0))


def measured(system=OTHER):
    """A response without noise."""
    G = system.response(OMEGA)
    return FrequencyResponse(
        omega=OMEGA, G=G, coherence=np.ones(G.shape), random_error=np.full(G.shape, 0.01),
        inputs=("u",), outputs=("y",), input_std=np.ones(1), output_std=np.ones(1),
    )  # fmt: skip


def priced(cases, **arguments):
    data = arguments.pop("data")
    return compare_bounds(Mixture(), data, cases=cases, execution=HERE, **arguments)


ESTIMATORS = {
    "hinf": {"data": TARGET, "estimator": Match(omega=OMEGA)},
    "derivid": {"data": measured(), "estimator": Derivid(starts=2)},
    "output_error": {"data": [record()], "estimator": OutputError()},
}


@pytest.mark.repeats(1)
@pytest.mark.second
@pytest.mark.filterwarnings("ignore:derivid. measured responses are farther off:casid.DataWarning")
@pytest.mark.parametrize("name", ESTIMATORS)
def test_prices_are_slopes_of_the_optimal_cost(name):
    free = priced({"free": {}}, **ESTIMATORS[name])["free"].parameters
    a, d = (next(row for row in free if row.name == key).value for key in ("a", "d"))
    step = 1e-3
    specs = {
        "free": {},
        **{f"{k}": {"a": f"< {a - 0.1 + k * step!r}"} for k in (-1, 0, 1)},
        **{f"tie {k}": [f"a + 2 d = {a + 2 * d - 0.1 + k * step!r}"] for k in (-1, 0, 1)},
    }
    found = priced(specs, **ESTIMATORS[name])
    assert not any(case.reason for case in found.cases)
    for before, at, after, price in (
        ("-1", "0", "1", next(r.multiplier for r in found["0"].parameters if r.active)),
        ("tie -1", "tie 0", "tie 1", found["tie 0"].relations[0].multiplier),
    ):
        slope = (found[after].cost - found[before].cost) / (2 * step)
        # central differences: an error of step² times the third derivative
        assert price == pytest.approx(slope, rel=1e-3), at
        assert found[at].increase > 0
    if name == "hinf":
        assert all(np.isnan(row.std_error) for row in found["free"].parameters)
        assert np.isnan(found["0"].aicc)


@pytest.mark.slow
def test_the_whole_chain_is_compared_with_one_black_box():
    settings = {
        "pbsid": Pbsid(order=2, pole=3.0, past=4, future=4),
        "match": Matching(omega=np.geomspace(0.7, 4.0, 20)),
    }
    cases = {"free": {}, "tie": ["a = 2 b"]}
    found = priced(cases, data=[record()], estimator=Chain(settings=settings))
    direct = priced(cases, data=[record()])
    for case in found.cases:
        assert case.reason == ""
        assert case.cost == pytest.approx(direct[case.name].cost, rel=1e-6)
        assert case.fit.method == "output error"


# ---- from the command line -----------------------------------------------------------------------

BOUNDS = """
[bounds]
estimator = "output_error"

[bounds.cases]
free = {}
"±20 %" = "±20 %"
fixed = { Lp = -2.0, Lv = "< 0" }

[bounds.cases.tie]
constraints = ["Llat = -5 Lp"]
"""


def asked(folder, bounds=BOUNDS):
    path = write_study(folder)
    path.write_text(path.read_text(encoding="utf-8") + bounds, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """A study whose cases were compared, and what the command said."""
    study = asked(tmp_path_factory.mktemp("told"))
    return study, CliRunner().invoke(main, ["bounds", str(study), "--png"])


@pytest.mark.slow
def test_casid_bounds_leaves_tables_figure_and_a_section(told):
    study, result = told
    assert result.exit_code == 0, result.output
    out = study.parent / "out"
    with (out / "bounds_cases.csv").open(encoding="utf-8") as file:
        rows = {row["case"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["free", "±20 %", "fixed", "tie"]
    for name in ("±20 %", "fixed", "tie"):
        assert float(rows[name]["increase"]) > 0
        assert rows[name]["start"] == "free"
    page = (out / "report.html").read_text(encoding="utf-8")
    assert '<section id="bounds">' in page
    assert "figure-bounds" in page
    for kind in ("svg", "png"):
        assert (out / "figures" / f"bounds.{kind}").stat().st_size > 0
    assert "±20 %" in (out / "bounds.md").read_text(encoding="utf-8")
    assert len(list((out / "bounds").glob("*.json"))) == 4
    for name in rows:
        assert name in result.output


@pytest.mark.slow
def test_a_comparison_stays_in_the_report_until_the_study_changes(told, caplog):
    study = told[0]
    page = study.parent / "out/report.html"
    cases = {path: path.stat().st_mtime_ns for path in (study.parent / "out/bounds").iterdir()}
    result = CliRunner().invoke(main, ["identify", str(study)])
    assert result.exit_code == 0
    assert '<section id="bounds">' in page.read_text(encoding="utf-8")
    assert "earlier state" not in caplog.text
    study.write_text(study.read_text(encoding="utf-8").replace("seed = 1", "seed = 2"), "utf-8")
    result = CliRunner().invoke(main, ["identify", str(study)])
    assert result.exit_code == 0
    text = page.read_text(encoding="utf-8")
    assert '<section id="bounds">' not in text
    for said in (text, caplog.text):
        assert "comparison of bounds in the folder of results is of an earlier state" in said
    assert {path: path.stat().st_mtime_ns for path in cases} == cases  # nothing was fitted


@pytest.mark.parametrize(
    ("bounds", "why"),
    [
        ("", "no table [bounds]"),
        (
            '[bounds]\nestimator = "guess"\n[bounds.cases]\nfree = {}\n',
            "expected one of chain, match",
        ),
        ("[bounds]\n", "there is no table [bounds.cases]"),
        ('[bounds.cases.odd]\nZq = "< 0"\n', "no parameter 'Zq'"),
        ("[bounds.cases]\n", "with cases to compare"),
    ],
)
def test_a_comparison_that_cannot_be_made_is_refused_at_once(bounds, why, tmp_path):
    result = CliRunner().invoke(main, ["bounds", str(asked(tmp_path, bounds))])
    assert result.exit_code == 2
    assert why in " ".join(result.output.split())
