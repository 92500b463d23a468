"""Every notebook of the documentation runs in a kernel of its own and shows what the page shows."""

import base64
import io
from pathlib import Path

import matplotlib.image
import nbformat
import numpy as np
import pytest

from docs.notebooks import executed

ROOT = Path(__file__).parent.parent
BOOKS = sorted((ROOT / "docs" / "gallery").glob("*.ipynb"))


def kinds(book):
    """What each cell shows: formats of its outputs."""
    return [
        [sorted(output.get("data", {output.output_type: ""})) for output in cell.get("outputs", [])]
        for cell in book.cells
    ]


@pytest.mark.campaign
@pytest.mark.filterwarnings("default")  # of Jupyter's own
@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_its_page_shows(path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert kinds(executed(path)) == kinds(nbformat.read(path, as_version=4))


def pictures(book):
    """The pictures that cells show, as arrays of pixels."""
    shown = [output.get("data", {}) for cell in book.cells for output in cell.get("outputs", [])]
    coded = [data["image/png"] for data in shown if "image/png" in data]
    return [matplotlib.image.imread(io.BytesIO(base64.b64decode(each))) for each in coded]


@pytest.mark.campaign
@pytest.mark.filterwarnings("default")  # of Jupyter's own
@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_draws_the_pictures_it_is_kept_with(path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    kept = pictures(nbformat.read(path, as_version=4))
    for drawn, before in zip(pictures(executed(path)), kept, strict=True):
        assert drawn.shape == before.shape
        apart = np.abs(drawn - before).max(axis=-1) > 0.25  # of full brightness
        assert apart.mean() < 0.002  # as in test_docs_figures.py


@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_with_what_it_shows_and_without_places_of_a_machine(path):
    book = nbformat.read(path, as_version=4)
    shown = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert any("text/html" in output.get("data", {}) for output in shown)
    assert all(output.output_type != "error" for output in shown)
    assert str(Path.home()) not in path.read_text(encoding="utf-8")
