"""The built site: references lead somewhere, formulas are typeset, nothing is fetched."""

import shutil
from pathlib import Path

import pytest

from docs.build import build, faults, legible

ROOT = Path(__file__).parent.parent
CHROMIUM = shutil.which("chromium")


def written(folder, body, name="index.html"):
    """A site of one page more."""
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(f"<html><body>{body}</body></html>", encoding="utf-8")
    return folder


def test_references_that_lead_somewhere_are_no_faults(tmp_path):
    written(tmp_path, '<h2 id="here">There</h2><img src="../a%20b.png">', "how-to/there.html")
    (tmp_path / "a b.png").touch()
    (tmp_path / "one.css").write_text("a {background: url('a%20b.png')}")
    written(
        tmp_path,
        '<a href="how-to/there.html#here">a</a><a href="#top" id="top">b</a>'
        '<a href="https://example.org">c</a><img src="data:image/png;base64,AA==">',
    )
    assert faults(tmp_path) == []


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ('<img src="images/none.png">', "is not in the site"),
        ('<a href="none.html">a</a>', "is not in the site"),
        ('<a href="/index.html">a</a>', "is not in the site"),
        ('<a href="#none">a</a>', "names no place of that page"),
        ('<a href="index.html#none">a</a>', "names no place of that page"),
        ('<script src="https://example.org/a.js"></script>', "is fetched from elsewhere"),
        ('<img src="//example.org/a.png">', "is fetched from elsewhere"),
    ],
)
def test_a_reference_that_leads_nowhere_is_named_with_its_page(tmp_path, body, why):
    (found,) = faults(written(tmp_path, body))
    assert found.startswith("index.html: ")
    assert found.endswith(why)


def test_a_style_sheet_fetches_nothing_from_elsewhere(tmp_path):
    (tmp_path / "one.css").write_text("@import url(https://example.org/a.css);")
    assert faults(tmp_path) == ["one.css: https://example.org/a.css is fetched from elsewhere"]


@pytest.mark.parametrize(
    ("formula", "told"),
    [
        (r"\dot x = A(\lambda)\, x + B\, u(t - \tau)", "x\u0307 = A(λ) x + B u(t - τ)"),
        (r"\hat D\, e^{-s\tau} \le \frac{1}{\sqrt{n}}", "D\u0302 e^(-sτ) ≤ (1)/(√(n))"),
        (r"\bigl\lVert S_{y}^{-1}\bigr\rVert_F \pm \tfrac{2}{N}", "‖ S_y^(-1)‖_F ± (2)/(N)"),
    ],
)
def test_formulas_are_legible_where_nothing_typesets_them(formula, told):
    assert legible(formula) == told


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    """The sources of the documentation in a folder of their own."""
    folder = tmp_path_factory.mktemp("sources")
    for name in ("casid", "docs", "examples", "models"):
        shutil.copytree(ROOT / name, folder / name)
    for name in ("CHANGELOG.md", "CONTRIBUTING.md", "zensical.toml"):
        shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def site(copied):
    """The site, built in a folder of its own."""
    build(copied)
    return copied / "site"


@pytest.mark.campaign
def test_a_page_with_broken_references_is_not_built(copied, capfd):
    page = copied / "docs" / "index.md"
    before = page.read_text(encoding="utf-8")
    page.write_text(f"{before}\n[a](none.md)\n\n[a](tutorial.md#none)\n", encoding="utf-8")
    try:
        with pytest.raises(SystemExit, match="the generator refuses the pages"):
            build(copied)
    finally:
        page.write_text(before, encoding="utf-8")
    assert "2 issues found" in "".join(capfd.readouterr())


@pytest.mark.slow
def test_every_page_is_built_where_it_stands_in_the_sources(site):
    for page in (ROOT / "docs").rglob("*.md"):
        assert (site / page.relative_to(ROOT / "docs")).with_suffix(".html").is_file()


@pytest.fixture(scope="module")
def tab():
    """A page of a browser."""
    sync_api = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser.new_page(viewport={"width": 390, "height": 844})
        browser.close()


@pytest.mark.campaign
@pytest.mark.parametrize("whole", [False, True], ids=["formulas", "all"])
def test_pages_opened_from_disk_typeset_their_formulas_and_fetch_nothing(whole, site, tab):
    asked, complaints = [], []
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    typeset = 0
    for path in sorted(site.rglob("*.html")):
        if path.name == "404.html" or not (
            whole or 'class="arithmatex"' in path.read_text("utf-8")
        ):
            continue
        tab.goto(path.as_uri())
        formulas = tab.locator(".arithmatex").count()
        typeset += formulas
        assert tab.locator(".arithmatex .katex").count() == formulas, path
        assert tab.locator(".katex-error").count() == 0, path
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390, path
    assert typeset > 0
    assert complaints == []
    assert {url.partition(":")[0] for url in asked} <= {"file", "data", "blob", "about"}


@pytest.mark.slow
def test_the_search_works_from_disk(site, tab):
    for name in ("search.json", "search.js"):
        text = (site / name).read_text(encoding="utf-8")
        assert "ẋ = A(λ) x + B(λ) u(t - τ)".replace("ẋ", "x\u0307") in text
        assert r"\\lambda" not in text
    tab.goto((site / "how-to" / "weights.html").as_uri())
    tab.keyboard.press("Control+k")
    tab.keyboard.type("from_laguerre", delay=20)
    tab.wait_for_timeout(1000)  # its results stand in a closed shadow tree
    tab.keyboard.press("Enter")
    tab.wait_for_url("**/reference/inside.html*")
