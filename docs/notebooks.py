"""Execute the notebooks of the gallery and keep what they show: python docs/notebooks.py."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent


def executed(path: Path) -> nbformat.NotebookNode:
    """A notebook with what its cells show in a kernel of their own, without times and counters."""
    book = nbformat.read(path, as_version=4)
    client = NotebookClient(book, timeout=300, resources={"metadata": {"path": str(ROOT)}})
    client.execute()
    for cell in book.cells:
        cell.metadata.clear()  # when it ran
    book.metadata = {"kernelspec": book.metadata["kernelspec"]}
    return book


if __name__ == "__main__":
    for path in sorted((ROOT / "docs" / "gallery").glob("*.ipynb")):
        nbformat.write(executed(path), path)
