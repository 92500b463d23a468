"""Every notebook of the documentation runs in a kernel of its own and shows what the page shows."""

from pathlib import Path

import nbformat
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


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of Jupyter's own
@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_its_page_shows(path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert kinds(executed(path)) == kinds(nbformat.read(path, as_version=4))


@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_with_what_it_shows_and_without_places_of_a_machine(path):
    book = nbformat.read(path, as_version=4)
    shown = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert any("text/html" in output.get("data", {}) for output in shown)
    assert all(output.output_type != "error" for output in shown)
    assert str(Path.home()) not in path.read_text(encoding="utf-8")
