"""Draw the figures of the documentation: python -m docs.figures, with names if not all."""

import contextlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from markdown_it import MarkdownIt

from casid import read_study, run_study
from docs import chain

ROOT = Path(__file__).parent.parent
IMAGES = ROOT / "docs" / "images"
TITLE = re.compile(r'title="([^"]+)"')
PNG = {"dpi": 150, "metadata": {"Software": None}}  # the version of matplotlib is no news


@contextlib.contextmanager
def _workplace() -> Iterator[Path]:
    """A folder to work in, with the examples and structures of the repository."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("examples", "models"):
            shutil.copytree(ROOT / part, folder / part, copy_function=os.symlink)
        os.chdir(folder)
        sys.path.insert(0, name)
        try:
            yield folder
        finally:
            sys.path.remove(name)
            os.chdir(before)


def _ran(page: Path, image: str, folder: Path) -> dict[str, Any]:
    """What the Python of a page has defined where it shows an image; its files are written."""
    names: dict[str, Any] = {"__name__": "page"}
    for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
        if token.type == "inline" and image in token.content:
            return names
        if token.type == "fence" and (title := TITLE.search(token.info)):
            (folder / title[1]).write_text(token.content, encoding="utf-8")
        elif token.type == "fence" and token.info.startswith("python"):
            exec(token.content, names)
    raise SystemExit(f"{page} does not show {image}")


def _plotted(page: str, value: str, **choice: bool) -> Callable[[Path], None]:
    """Draws the plot of a value that the Python of a page computes."""

    def draw(target: Path) -> None:
        mpl.use("Agg")
        with _workplace() as folder:
            names = _ran(ROOT / "docs" / page, target.name, folder)
            figure = np.ravel(names[value].plot(**choice))[0].figure
            figure.savefig(target, bbox_inches="tight" if choice else None, **PNG)

    return draw


def _of_study(study: str, figure: str) -> Callable[[Path], None]:
    """Draws a figure of a study's report."""

    def draw(target: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            run_study(replace(read_study(ROOT / study, Path(folder)), png=True))
            shutil.copy(Path(folder) / "figures" / figure, target)

    return draw


FIGURES: dict[str, Callable[[Path], None]] = {
    "chain.svg": chain.draw,
    "design.png": _plotted("how-to/design.md", "design"),
    "design_errors.png": _plotted("how-to/design.md", "design", errors=True),
    "envelope.png": _plotted("how-to/envelope.md", "over"),
    "responses.png": _of_study("examples/ah1s/study.toml", "response_p_q_r_from_ped_lon.png"),
}


if __name__ == "__main__":
    for name in sys.argv[1:] or FIGURES:
        FIGURES[name](IMAGES / name)
