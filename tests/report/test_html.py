"""The report page: what it tells, in a browser and on paper, what it must not do."""

import dataclasses
import re
import shutil
import subprocess
from hashlib import sha256
from types import MappingProxyType
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import pytest
from truths.pages import changed, shown

from casid.report import (
    BASELINE,
    BLACK_BOX,
    MATCH,
    OUTPUT_ERROR,
    write_report,
)
from casid.report.html import address
from casid.report.words import number

MODELS = (BLACK_BOX, MATCH, OUTPUT_ERROR, BASELINE)
CHROMIUM = shutil.which("chromium")
HOSTILE = '<img src=x onerror="document.title=1">&{{ 7*7 }}</script>'


# ---- the page ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_page_needs_nothing_beside_it_and_is_below_three_megabytes(page):
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size < 3e6
    markup = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    for attribute in re.findall(r'(?:src|href)="([^"]*)"', markup):
        assert attribute.startswith(("data:", "#")), attribute[:60]
    assert "@import" not in text
    assert "url(" not in re.search(r"<style>(.*?)</style>", text, flags=re.DOTALL)[1]


@pytest.mark.slow
def test_figures_are_png_too_if_asked_for_and_the_page_stays_as_it_is(content, page, tmp_path):
    figures = {path.name for path in (page.parent / "figures").iterdir()}
    assert all(name.endswith(".svg") for name in figures)
    asked = dataclasses.replace(content, png=True)
    again = write_report(asked, shown(asked), tmp_path)
    assert again.read_bytes() == page.read_bytes()
    found = {path.name for path in (tmp_path / "figures").iterdir()}
    assert found == figures | {name.replace(".svg", ".png") for name in figures}


@pytest.mark.slow
def test_the_page_tells_what_is_needed_to_repeat_the_run(page, content, study_folder):
    text = page.read_text(encoding="utf-8")
    assert sha256((study_folder / "study.toml").read_bytes()).hexdigest() in text
    for file in content.data:
        assert file.sha256 in text
    assert sha256((study_folder / "roll.py").read_bytes()).hexdigest() in text
    for word_ in ("pbsid.order", "lat: %", "casadi", "numpy", "seed 1", *content.model_files):
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


@pytest.mark.second
def test_standard_errors_and_the_cramer_rao_bound_stand_side_by_side(page, content):
    text = page.read_text(encoding="utf-8")
    for row in content.results["output_error"].parameters:
        for value in (row.std_error, row.cramer_rao):
            assert f'<td data-value="{value}">{number(value, 2)}</td>' in text


def test_a_star_is_explained_where_there_is_one(page):
    text = page.read_text(encoding="utf-8")
    starred = re.search(r'<td data-value="[^"]*">[^<]*\d\*</td>', text)
    assert (starred is not None) == ("* on its bound in that fit." in text)


def test_a_picture_as_an_address_is_the_same_picture():
    drawn = "M 10.1234 0 L 11 20.56 L 10.8 4 z M 5 6 M 1 2 L 1.2 10"  # one point alone
    line = f"""<path d="{drawn}" style="font: 8px 'DejaVu Sans'; fill: #00ff00"/>"""
    said = "<text>5\" &lt; 6 &amp; 7' 100 %</text>"
    svg = f'<svg xmlns="http://www.w3.org/2000/svg"><g id="a">{line}{said}</g></svg>'
    found = address(svg)
    assert '"' not in found
    assert "&" not in found
    kept = ET.fromstring(unquote(found.partition(",")[2]))
    path, text = (kept.find(f".//{{http://www.w3.org/2000/svg}}{tag}") for tag in ("path", "text"))
    assert path.get("d") == "M10.1 0l.9 20.5-.2-16.5zM5 6M1 2l.2 8"
    assert path.get("style") == "font: 8px DejaVu Sans; fill: #00ff00"
    assert text.text == "5\" < 6 & 7' 100 %"


# ---- in a browser ------------------------------------------------------------------------------

browser = pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")


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
@pytest.mark.campaign
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
