"""The page under a user's hands: a real browser, real clicks, a telephone's width."""

import dataclasses
import shutil

import pytest
from truths.pages import changed, shown

from casid import qualify
from casid.bounds.compare import BoundsComparison
from casid.bounds.prices import CaseResult
from casid.report import write_report

CHROMIUM = shutil.which("chromium")
sync_api = pytest.importorskip("playwright.sync_api")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium"),
    # Playwright leaves its event loop to the collector.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def chromium():
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def compared(content, tmp_path_factory):
    """A page with three cases of bounds (free, Lp moved by 3σ, held) and room to sign."""
    rows = content.results["output_error"].parameters
    (first, *others) = (dataclasses.replace(row, std_error=0.1, active=False) for row in rows)
    moved = dataclasses.replace(first, value=first.value + 0.3)
    held = dataclasses.replace(first, value=first.value - 0.7, active=True, std_error=float("nan"))
    cases = tuple(
        CaseResult(name=name, parameters=(row, *others), cost=cost, increase=cost, shares=shares)
        for name, row, cost, shares in (
            ("free", first, 0.0, {}),
            ("moved", moved, 4.0, {}),
            ("held", held, 8.0, {first.name: 7.5}),
        )
    )
    found = BoundsComparison(cases=cases, freest="free", estimator="output error", structure="Roll")
    judged = qualify(content.results["validation"], tolerances={"p": "10 % or 3 deg/s"})
    page = changed(content, bounds=found, qualification=judged)
    return write_report(page, shown(page), tmp_path_factory.mktemp("compared"))


@pytest.fixture
def page(chromium, compared):
    found = chromium.new_page(viewport={"width": 1280, "height": 900})
    problems = []
    found.on("pageerror", lambda error: problems.append(str(error)))
    found.on("console", lambda said: problems.append(said.text) if said.type == "error" else None)
    found.goto(compared.as_uri())
    yield found
    found.close()
    assert problems == []


def cells(page, table):
    rows = page.locator(f"{table} tbody tr:visible")
    return [row.locator("td").first.inner_text() for row in rows.all()]


def test_the_bounds_explorer_says_what_moves_between_the_cases_chosen(page, content):
    name = content.results["output_error"].parameters[0].name
    explorer = page.locator(".explorer")
    largest = explorer.locator("table tbody tr:visible td:last-child").first
    assert cells(page, ".explorer")[0] == name  # what moves most comes first
    assert largest.inner_text() == "7.0σ"
    explorer.get_by_role("checkbox", name="held").click()
    assert largest.inner_text() == "3.0σ"
    assert not explorer.locator("li", has_text="held").is_visible()
    explorer.get_by_label("that move by").select_option("5")
    assert cells(page, ".explorer") == []
    explorer.get_by_role("checkbox", name="held").click()
    assert cells(page, ".explorer") == [name]
    assert "costs 7.5" in explorer.locator("tbody tr:visible").inner_text()
    explorer.get_by_label("against").select_option("1")
    assert largest.inner_text() == "10.0σ"


def test_parameters_are_found_by_name_and_by_what_is_wrong_with_them(page, content):
    names = [row.name for row in content.results["output_error"].parameters]
    table = "#parameter-table"
    assert cells(page, table) == names
    page.get_by_label("Find").fill(names[-1].upper())
    assert names[-1] in cells(page, table)
    assert len(cells(page, table)) < len(names)
    page.get_by_label("Find").fill("")
    page.get_by_label("Show").select_option("held")
    assert cells(page, table) == []
    assert page.locator("[data-filter] output").inner_text() == f"0 of {len(names)}"


def test_all_plots_are_drawn_with_their_curves(page):
    page.set_viewport_size({"width": 1300, "height": 9000})
    figures = page.locator("figure.interactive")
    for figure in figures.all():
        figure.scroll_into_view_if_needed()
    page.wait_for_function(
        "[...document.querySelectorAll('figure.interactive')].every((f) => f.dataset.state)"
    )
    assert figures.count() > 5
    assert page.locator("figure .scatterlayer path.js-line").count() > 20


def test_the_page_asks_for_nothing_but_itself(chromium, compared):
    found, asked = chromium.new_page(viewport={"width": 1300, "height": 9000}), []
    found.on("request", lambda request: asked.append(request.url))
    found.goto(compared.as_uri(), wait_until="load")
    found.wait_for_function("document.querySelector('figure.interactive').dataset.state")
    assert compared.stat().st_size < 3e6
    assert [url for url in asked if not url.startswith("data:")] == [compared.as_uri()]
    found.close()


def test_headings_sort_by_the_keyboard_too(page, content):
    rows = sorted(content.results["output_error"].parameters, key=lambda row: row.value)
    page.get_by_role("button", name="Value", exact=True).first.focus()
    page.keyboard.press("Enter")
    assert cells(page, "#parameter-table") == [row.name for row in rows]
    page.keyboard.press(" ")
    assert cells(page, "#parameter-table") == [row.name for row in rows[::-1]]


def test_on_a_telephone_nothing_is_wider_than_the_screen_and_pictures_keep_their_size(
    chromium, compared
):
    found = chromium.new_page(viewport={"width": 390, "height": 844})
    found.goto(compared.as_uri())
    assert found.evaluate("document.documentElement.scrollWidth") == 390
    assert found.locator("table.signoff").count() == 1
    widths = "[...document.querySelectorAll('figure img')].map((i) => i.width / i.naturalWidth)"
    assert found.evaluate(widths) == pytest.approx([1.0] * found.locator("figure img").count())
    found.close()


def test_on_paper_no_table_is_wider_than_its_page(chromium, compared):
    found = chromium.new_page(viewport={"width": 687, "height": 1000})  # 210 - 2 x 14 mm
    found.emulate_media(media="print")
    found.goto(compared.as_uri())
    rights = """[...document.querySelectorAll("table, figure, img, p, li")].map((each) => [
        each.getBoundingClientRect().right, each.closest("#parameters") ? 1016 : 687,
        each.textContent.trim().slice(0, 40)])"""
    assert [each for each in found.evaluate(rights) if each[0] > each[1]] == []
    # Chromium repeats a heading on the next page, but not the buttons in it.
    button = found.locator("th button").first
    assert button.evaluate("(each) => getComputedStyle(each).display") == "contents"
    found.close()
