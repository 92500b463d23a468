"""Every figure of the documentation has a command that draws it, and is what the command draws."""

import re

import matplotlib.image
import numpy as np
import pytest

from docs.figures import FIGURES, IMAGES, ROOT

PAGES = (*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md")
SHOWN = re.compile(r"!\[[^\]]*\]\(([^)\s]+)|<img[^>]*src=[\"']([^\"']+)")
NUMBER = re.compile(r"-?\d+\.\d+")


def test_every_figure_of_a_page_has_a_command():
    for page in PAGES:
        for match in SHOWN.finditer(page.read_text(encoding="utf-8")):
            shown = (page.parent / (match[1] or match[2])).resolve()
            assert shown.parent == IMAGES, page
            assert shown.name in FIGURES, page


def test_no_figure_lies_among_the_pages_that_no_command_draws():
    formats = {".png", ".svg", ".jpg", ".jpeg", ".gif", ".webp", ".pdf"}
    found = {path for path in (ROOT / "docs").rglob("*") if path.suffix in formats}
    assert found == {IMAGES / name for name in FIGURES}


def test_one_command_draws_all_and_is_told_to_contributors():
    rule = (ROOT / "Makefile").read_text("utf-8").partition("\nfigures: ")[2].partition("\n\n")[0]
    assert re.findall(r"-m docs\.(\w+)", rule) == ["figures", "notebooks"]
    assert "`make figures`" in (ROOT / "CONTRIBUTING.md").read_text("utf-8")


def test_the_chain_is_what_its_command_draws(tmp_path):
    FIGURES["chain.svg"](tmp_path / "chain.svg")
    texts = [(folder / "chain.svg").read_text(encoding="utf-8") for folder in (tmp_path, IMAGES)]
    assert NUMBER.sub("#", texts[0]) == NUMBER.sub("#", texts[1])
    drawn, kept = ([float(number) for number in NUMBER.findall(text)] for text in texts)
    assert drawn == pytest.approx(kept, abs=0.01)  # points; another processor rounds otherwise


@pytest.mark.campaign
@pytest.mark.filterwarnings("default")  # of the pages' data
@pytest.mark.parametrize("name", sorted(name for name in FIGURES if name.endswith(".png")))
def test_a_figure_is_what_its_command_draws(name, tmp_path):
    FIGURES[name](tmp_path / name)
    drawn, kept = (matplotlib.image.imread(folder / name) for folder in (tmp_path, IMAGES))
    assert drawn.shape == kept.shape
    apart = np.abs(drawn - kept).max(axis=-1) > 0.25  # of full brightness
    assert apart.mean() < 0.002  # edges of lines; a line moved by its width is several times that
