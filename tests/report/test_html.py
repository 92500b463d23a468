"""Figures and the report page: what they show, in a browser and on paper, what they must not."""

import dataclasses
import json
import re
import shutil
import subprocess
from hashlib import sha256
from types import MappingProxyType

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from truths.roll_study import write_study

from casid import read_study, run_study
from casid.channels import units_of
from casid.fit import ParameterEstimate
from casid.report import (
    BASELINE,
    BLACK_BOX,
    MATCH,
    OUTPUT_ERROR,
    plot_history,
    plot_magnitude,
    plot_measured,
    plot_phase,
    plot_rms,
    write_report,
)
from casid.report import html as html_module
from casid.report.drawings import LOOK
from casid.report.evidence import noise_levels
from casid.report.figures import decibel, groups, input_pairs, phase, style
from casid.report.interactive import interactive
from casid.report.verdicts import verdicts, word
from casid.report.words import number, percent
from casid.stages.listing import STAGES, sections

MODELS = (BLACK_BOX, MATCH, OUTPUT_ERROR, BASELINE)
CHROMIUM = shutil.which("chromium")
HOSTILE = '<img src=x onerror="document.title=1">&{{ 7*7 }}</script>'


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture(scope="module")
def content(study_folder):
    """What the runner hands to the report at the end of a small study."""
    kept = []

    def keeping(content, sections, folder):
        kept.append(content)
        return write_report(content, sections, folder)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("casid.studies.runner.write_report", keeping)
        run_study(
            read_study(
                write_study(
                    study_folder,
                    (
                        "[records.validation]",
                        "[records.frequency]\nfiles = ['sweep.csv']\nnoise = true\n\n"
                        "[records.validation]",
                    ),
                    ("[match]", "[frequency]\nomega = {from=0.6, to=5, points=20}\n\n[match]"),
                )
            )
        )
    return kept[0]


@pytest.fixture(scope="module")
def page(content, study_folder):  # noqa: ARG001 - the study is run once, by content
    return study_folder / "out" / "report.html"


def shown(content):
    """The sections of what the stages found."""
    return sections(STAGES, content.results, content)


def draw(content):
    """All figures."""
    with rc_context(LOOK):
        yield from (drawing for section in shown(content) for drawing in section.draw())


def cautions(content):
    return html_module.cautions(content, shown(content))


def changed(content, **results):
    """Content with other results of some stages."""
    labels = {stage.label: stage.name for stage in STAGES if stage.label}
    found = dict(content.results) | results
    models = {label: found[labels[label]] for label in content.models}
    return dataclasses.replace(content, results=found, models=models)


def axes(rows=1):
    return Figure().subplots(rows, 1, squeeze=False)[:, 0]


# ---- figures -----------------------------------------------------------------------------------


def test_magnitude_and_phase_of_an_integrator_are_its_textbook_ones():
    omega = np.array([0.1, 1.0, 10.0])
    G = 1 / (1j * omega)
    np.testing.assert_allclose(decibel(G), [20, 0, -20], atol=1e-12)
    np.testing.assert_allclose(phase(G), -90, atol=1e-12)
    top, bottom = axes(2)
    plot_magnitude(top, omega, G, name=BLACK_BOX)
    plot_phase(bottom, omega, G, name=BLACK_BOX)
    np.testing.assert_allclose(top.lines[0].get_ydata(), [20, 0, -20], atol=1e-12)
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("magnitude [dB]", "phase [deg]")


def test_phase_is_taken_on_the_turn_of_its_neighbour():
    omega = np.geomspace(0.1, 10, 50)
    G = np.exp(-1j * omega) / (1j * omega) ** 2
    np.testing.assert_allclose(phase(G, phase(G) + 720) - phase(G), 720, atol=1e-9)


def test_phase_passes_over_pairs_that_were_not_measured():
    G = np.array([1j, np.nan, -1.0])
    np.testing.assert_allclose(phase(G), [90, np.nan, 180])
    assert np.isnan(phase(np.full(3, np.nan + 0j))).all()


def test_a_history_keeps_the_gap_of_missing_samples():
    ax = axes()[0]
    t, y = np.arange(4.0), np.array([0.0, np.nan, 2.0, 3.0])
    assert plot_history(ax, t, y, {OUTPUT_ERROR: y}, channel="q") is ax
    assert np.isnan(ax.lines[0].get_ydata()[1])
    assert ax.get_ylabel() == "q [rad/s]"


def test_styles_differ_in_dash_and_not_in_colour_alone():
    looks = [style(name) for name in MODELS]
    assert len({str(look["linestyle"]) for look in looks}) == len(looks)
    assert len({look["color"] for look in looks}) == len(looks)


def test_outputs_and_inputs_are_laid_out_as_in_the_paper():
    outputs = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "beta")
    assert groups(outputs) == [("ax", "ay", "az"), ("phi", "theta"), ("p", "q", "r"), ("beta",)]
    assert input_pairs(("col", "lat", "lon", "ped")) == [("col", "lat"), ("ped", "lon")]
    assert input_pairs(("elevator", "aileron", "rudder")) == [("elevator", "aileron"), ("rudder",)]


@pytest.mark.slow
def test_rms_bars_have_the_heights_of_the_normalised_errors(content):
    ax = axes()[0]
    plot_rms(ax, content.results["validation"])
    heights = [bar.get_height() for bar in ax.containers[0]]
    np.testing.assert_allclose(heights, content.results["validation"].normalised[BLACK_BOX][0])


@pytest.mark.slow
def test_a_measured_response_lies_within_its_band(content):
    top, bottom = axes(2)
    plot_measured(top, bottom, content.results["frequency"], (0, 0))
    curve = top.lines[0].get_xydata()
    band = np.vstack([path.vertices for path in top.collections[0].get_paths()])
    measured = curve[np.isfinite(curve[:, 1])]
    assert len(measured) > 10
    for omega, value in measured:
        edges = band[np.isclose(band[:, 0], omega), 1]
        assert edges.min() <= value <= edges.max()


@pytest.mark.slow
def test_every_figure_names_the_unit_of_every_axis(content):
    for drawing in draw(content):
        for ax in drawing.figure.axes:
            labels = [ax.get_ylabel()] if ax.get_ylabel() else []
            if ax.xaxis.get_tick_params().get("labelbottom", True) and ax.get_xlabel():
                labels.append(ax.get_xlabel())
            assert all(re.search(r"\[.+\]", label) for label in labels), (drawing.name, labels)
        assert any(ax.get_ylabel() for ax in drawing.figure.axes)


@pytest.mark.slow
def test_a_stick_in_degrees_is_shown_in_radians(content, tmp_path):
    angle = dataclasses.replace(content, units=units_of({"lat": "deg"}))
    labels = [ax.get_ylabel() for drawing in draw(angle) for ax in drawing.figure.axes]
    assert "lat\n[rad]" in labels
    assert "lat rad." in write_report(angle, shown(angle), tmp_path).read_text(encoding="utf-8")


@pytest.mark.slow
def test_no_label_covers_another_or_leaves_the_paper(content):
    for drawing in draw(content):
        canvas = FigureCanvasAgg(drawing.figure)
        canvas.draw()
        paper, pen = drawing.figure.bbox, canvas.get_renderer()
        names, ticks = [], []
        for ax in drawing.figure.axes:
            if ax.get_visible() and ax.get_ylabel():
                names.append(ax.yaxis.label.get_window_extent(pen))
                inside = ax.get_ylim()
                ticks += [tick.label1.get_window_extent(pen) for tick in ax.yaxis.get_major_ticks()
                          if inside[0] <= tick.get_loc() <= inside[1]]  # fmt: skip
        for name in names:
            assert name.x0 >= paper.x0, drawing.name
            assert name.count_overlaps([*names, *ticks]) == 1, drawing.name  # itself


@pytest.mark.slow
def test_the_interactive_plot_has_the_curves_of_the_picture(content):
    drawing = next(d for d in draw(content) if d.name.startswith("response"))
    plot = json.loads(interactive(drawing.figure))
    curves = [line for ax in drawing.figure.axes for line in ax.lines if len(line.get_xdata()) > 2]
    bands = [collection for ax in drawing.figure.axes for collection in ax.collections]
    assert len(plot["data"]) == len(curves) + len(bands)
    shown = [trace["name"] for trace in plot["data"] if trace["showlegend"]]
    assert len(shown) == len(set(shown))
    assert {BLACK_BOX, OUTPUT_ERROR} <= set(shown)


# ---- words -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"),
    [(1234.5, "1234"), (-0.5, "−0.5"), (1e-7, "1e−7"), (np.nan, "–"), (-np.inf, "−∞"), (None, "–")],
)
def test_numbers_are_written_for_readers(value, text):
    assert number(value) == text


def test_a_standard_error_far_above_the_value_is_not_spelt_out():
    row = ParameterEstimate(
        name="Xu", value=1e-9, guess=0.0, lower=-1.0, upper=0.0, active=False, multiplier=0.0,
        std_error=0.1, insensitivity=0.1, unit="1/s",
    )  # fmt: skip
    assert percent(row) == "> 999"
    assert percent(dataclasses.replace(row, value=0.0)) == "–"


@pytest.mark.parametrize(
    ("theil", "said"), [(0.05, "good"), (0.2, "fair"), (0.7, "poor"), (np.nan, "not judged")]
)
def test_verdicts_follow_theils_coefficient(theil, said):
    assert word(theil) == said


@pytest.mark.slow
def test_the_summary_warns_of_bounds_signs_and_wide_certificates(content):
    fit = content.results["output_error"]
    rows = [dataclasses.replace(row, std_error=1e3) for row in fit.parameters]
    rows[0] = dataclasses.replace(rows[0], active=True)
    loose = dataclasses.replace(content.results["hinf"].certificate, grid_norm=1.0, upper_bound=1.5)
    worried = changed(
        dataclasses.replace(content, warnings=("a record was short",)),
        output_error=dataclasses.replace(fit, parameters=tuple(rows), success=False),
        hinf=dataclasses.replace(content.results["hinf"], certificate=loose),
    )
    said = " ".join(cautions(worried))
    for words in (
        "1 parameter lies on a bound: Yv", "sign of 3 parameters is not determined",
        "known to 50.0% only", "a record was short",
    ):  # fmt: skip
        assert words in said


@pytest.mark.slow
def test_the_summary_goes_by_standard_errors_and_says_if_residuals_are_coloured(content):
    fit = content.results["output_error"]

    def said(ratio):
        rows = [
            dataclasses.replace(row, value=3.0, std_error=ratio, cramer_rao=1.0)
            for row in fit.parameters
        ]
        judged = dataclasses.replace(fit, parameters=tuple(rows))
        return " ".join(cautions(changed(content, output_error=judged)))

    assert "correlated" not in said(1.2)
    assert "typically 2.0 times the Cramér-Rao bound" in said(2.0)
    assert "sign of" not in said(2.0)  # 3 ± 2
    assert f"sign of {len(fit.parameters)} parameters is not determined" in said(4.0)


@pytest.mark.slow
def test_a_verdict_is_of_all_unseen_records_together(content):
    validation = content.results["validation"]
    twice = dataclasses.replace(
        validation,
        records=validation.records * 2,
        measured=validation.measured * 2,
        simulated={name: ys * 2 for name, ys in validation.simulated.items()},
        theil={name: np.vstack([values, values]) for name, values in validation.theil.items()},
    )
    for found in (verdicts(validation, content), verdicts(twice, content)):
        assert [verdict.output for verdict in found] == ["p", "phi"]
        for name in ("rms", "fit", "theil"):  # the same record twice is no news
            np.testing.assert_allclose(
                [getattr(verdict, name) for verdict in found],
                getattr(validation, name)[OUTPUT_ERROR][0],
            )
    assert all(len(set(verdict.records)) == 1 < len(verdict.records) for verdict in found)


@pytest.mark.slow
def test_an_error_of_the_size_of_the_noise_is_not_held_against_the_model(content):
    fit = content.results["output_error"]
    validation = content.results["validation"]
    found = verdicts(validation, content)
    np.testing.assert_allclose([v.residual for v in found], np.sqrt(np.diag(fit.R)))
    np.testing.assert_allclose([v.noise for v in found], noise_levels(validation.measured))
    loud = [
        dataclasses.replace(v, noise=v.rms / size) for v, size in zip(found, [1, 1.5], strict=True)
    ]
    assert [v.noisy for v in loud] == [True, False]
    assert [v.caution.endswith("it hardly moves.") for v in loud] == [True, False]
    unknown = verdicts(validation, changed(content, output_error=dataclasses.replace(fit, R=None)))
    assert np.isnan([v.residual for v in unknown]).all()


# ---- the page ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_needs_nothing_beside_it_and_is_below_eight_megabytes(page):
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 8e6
    markup = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    for attribute in re.findall(r'(?:src|href)="([^"]*)"', markup):
        assert attribute.startswith(("data:", "#")), attribute[:60]
    assert "@import" not in text
    assert "url(" not in re.search(r"<style>(.*?)</style>", text, flags=re.DOTALL)[1]


@pytest.mark.slow
def test_the_page_tells_what_is_needed_to_repeat_the_run(page, content, study_folder):
    text = page.read_text(encoding="utf-8")
    assert sha256((study_folder / "study.toml").read_bytes()).hexdigest() in text
    for file in content.data:
        assert file.sha256 in text
    for word_ in ("pbsid.order", "lat %", "casadi", "numpy", "seed 1", content.model_digest):
        assert word_ in text


@pytest.mark.slow
def test_names_and_paths_from_users_are_escaped(content, tmp_path):
    record = dataclasses.replace(content.results["validation"].measured[0], name=HOSTILE)
    judged = dataclasses.replace(
        content.results["validation"], records=(HOSTILE,), measured=(record,)
    )
    hostile = dataclasses.replace(
        changed(content, validation=judged),
        title=HOSTILE,
        data=(dataclasses.replace(content.data[0], name=HOSTILE, path=HOSTILE),),
        settings=MappingProxyType({HOSTILE: HOSTILE}),
        warnings=(HOSTILE,),
    )
    text = write_report(hostile, shown(hostile), tmp_path).read_text(encoding="utf-8")
    assert "<img src=x" not in text
    assert (
        "&lt;img src=x onerror=&#34;document.title=1&#34;&gt;&amp;{{ 7*7 }}&lt;/script&gt;" in text
    )
    assert all(path.parent == tmp_path / "figures" for path in (tmp_path / "figures").iterdir())
    if CHROMIUM:
        assert "<title>1</title>" not in _dom(tmp_path / "report.html")


@pytest.mark.slow
def test_the_page_tells_what_each_source_contributes_to_the_match(page, content):
    text = page.read_text(encoding="utf-8")
    for row in content.results["hinf"].notes.sources:
        assert f'<th class="left">{row.name}</th><td>{len(row.grid)}</td>' in text


def test_standard_errors_and_the_cramer_rao_bound_stand_side_by_side(page, content):
    text = page.read_text(encoding="utf-8")
    for row in content.results["output_error"].parameters:
        for value in (row.std_error, row.cramer_rao):
            assert f'<td data-value="{value}">{number(value, 2)}</td>' in text


# ---- in a browser ------------------------------------------------------------------------------

browser = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")

# Runs after the page's own scripts: sorts the parameters twice, collects errors, waits for plots.
PROBE = """
<script>
window.problems = [];
const honest = console.error;
console.error = (...words) => { problems.push(words.join(" ")); honest(...words); };
window.addEventListener("error", (event) => problems.push(event.message));
window.addEventListener("unhandledrejection", (event) => problems.push(String(event.reason)));
window.addEventListener("load", () => {
  const table = document.querySelector("#parameters table.sortable");
  const order = () => [...table.tBodies[0].rows].map((row) => row.cells[0].textContent).join(" ");
  const answers = { before: order() };
  table.tHead.rows[0].cells[1].click();
  answers.up = order();
  table.tHead.rows[0].cells[1].click();
  answers.down = order();
  const report = () => {
    const wanted = document.querySelectorAll("figure.interactive").length;
    answers.wanted = wanted;
    answers.drawn = document.querySelectorAll("figure[data-state=drawn] .main-svg").length > 0
      ? document.querySelectorAll("figure[data-state=drawn]").length : 0;
    answers.curves = document.querySelectorAll("figure .scatterlayer path.js-line").length;
    answers.problems = problems;
    document.body.dataset.answers = JSON.stringify(answers);
    if (answers.drawn < wanted) setTimeout(report, 100);
  };
  report();
});
</script>
"""


def _dom(path, *options):
    profile = path.parent / "profile"
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
        f"--user-data-dir={profile}", "--window-size=1300,30000", "--virtual-time-budget=20000",
        *options, "--dump-dom", path.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    shutil.rmtree(profile, ignore_errors=True)
    return done.stdout


@browser
@pytest.mark.slow
def test_in_a_browser_plots_draw_tables_sort_and_nothing_complains(page, tmp_path, content):
    probed = tmp_path / "report.html"
    text = page.read_text(encoding="utf-8").replace("<head>", f"<head>{PROBE}", 1)
    probed.write_text(text, encoding="utf-8")
    answers = re.search(r'data-answers="([^"]*)"', _dom(probed))[1]
    found = json.loads(answers.replace("&quot;", '"').replace("&amp;", "&"))
    assert found["problems"] == []
    assert found["drawn"] == found["wanted"] > 5
    assert found["curves"] > 20
    table = content.results["output_error"].parameters
    rows = sorted(table, key=lambda row: row.value)
    assert found["before"].split() == [row.name for row in table]
    assert found["up"].split() == [row.name for row in rows]
    assert found["down"].split() == [row.name for row in rows[::-1]]


@browser
@pytest.mark.slow
def test_without_scripts_the_static_pictures_show(page, tmp_path):
    text = re.sub(r"<script.*?</script>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    measure = """<script>window.addEventListener("load", () => {
      const all = [...document.querySelectorAll("figure img")];
      document.body.dataset.seen = all
        .filter((image) => image.naturalWidth > 100 && image.offsetHeight > 50).length
        + "/" + all.length;
    });</script>"""
    (tmp_path / "static.html").write_text(text.replace("<head>", f"<head>{measure}", 1))
    seen, there = re.search(r'data-seen="(\d+)/(\d+)"', _dom(tmp_path / "static.html")).groups()
    assert int(seen) == int(there) > 5


@browser
@pytest.mark.slow
def test_on_paper_the_page_is_a_few_sheets(page, tmp_path):
    pdf = tmp_path / "report.pdf"
    subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
         f"--user-data-dir={tmp_path / 'profile'}", f"--print-to-pdf={pdf}",
         "--no-pdf-header-footer", page.as_uri()],
        capture_output=True, timeout=600, check=True,
    )  # fmt: skip
    sheets = len(re.findall(rb"/Type\s*/Page\b", pdf.read_bytes()))
    assert 3 <= sheets <= 20
