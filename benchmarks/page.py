"""How long a browser takes to open a report, and what it asks for: the study of examples/uh60.

Chromium loads the page from disk, as often as said, each time in a fresh context. "Processor"
is what the page's process takes from the first byte until the load event; the clock's figure is the
best of all, which is what an idle machine takes. Needs Chromium and Playwright:

    python -m benchmarks.page [REPORT.html] [--times 5]
"""

import argparse
import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from benchmarks.tables import against, table
from casid import read_study, run_study

STUDY = Path(__file__).resolve().parent.parent / "examples" / "uh60" / "study.toml"
SIZE, SECONDS = 3.0, 2.0  # MB; s


def opened(browser: Browser, page: Path) -> tuple[float, float, list[str]]:
    """Seconds by the clock and of the processor until a page is loaded, and what it asked for."""
    sheet = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
    asked: list[str] = []
    sheet.on("request", lambda request: asked.append(request.url))
    tools = sheet.context.new_cdp_session(sheet)
    tools.send("Performance.enable")
    sheet.goto(page.as_uri(), wait_until="load")
    seen = {each["name"]: each["value"] for each in tools.send("Performance.getMetrics")["metrics"]}
    clock = sheet.evaluate("performance.getEntriesByType('navigation')[0].loadEventEnd") / 1000
    sheet.context.close()
    away = [each for each in asked if each != page.as_uri() and not each.startswith("data:")]
    return clock, seen["ProcessTime"], away


def measure(page: Path, times: int) -> str:
    """The table of one page."""
    with sync_playwright() as playwright:
        chromium = shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        found = [opened(browser, page) for _ in range(times)]
        browser.close()
    clock, processor = (min(each[k] for each in found) for k in (0, 1))
    rows = [
        ["size [MB]", against(page.stat().st_size / 1e6, SIZE)],
        ["loaded, by the clock [s]", against(clock, SECONDS)],
        ["loaded, processor [s]", f"{processor:.2g}"],
        ["asked for beside the page", str(sum(len(away) for *_, away in found))],
    ]
    return table(["report of the UH-60", "figure"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("report", type=Path, nargs="?")
    parser.add_argument("--times", type=int, default=5)
    asked = parser.parse_args()
    if asked.report:
        print(measure(asked.report.resolve(), asked.times))
        return
    with tempfile.TemporaryDirectory() as folder:
        run_study(read_study(STUDY, Path(folder)))
        print(measure(Path(folder) / "report.html", asked.times))


if __name__ == "__main__":
    main()
