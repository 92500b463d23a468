"""Notebooks of the gallery: this program executes them, its extension of Markdown shows them."""

import re
from html import escape
from pathlib import Path

import nbformat
from markdown import Markdown
from markdown.extensions import Extension
from markdown.preprocessors import Preprocessor
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent
GALLERY = ROOT / "docs" / "gallery"
LINK = re.compile(r"\[.+\]\((\w+\.ipynb)\)")
AFTER_WHITESPACE = 29  # priority: stashed outputs must not be cleaned, fences come later (25)


def executed(path: Path) -> nbformat.NotebookNode:
    """A notebook with what its cells show in a kernel of their own, without times and counters."""
    book = nbformat.read(path, as_version=4)
    client = NotebookClient(book, timeout=300, resources={"metadata": {"path": str(ROOT)}})
    client.execute()
    for cell in book.cells:
        cell.metadata.clear()  # when it ran
    book.metadata = {"kernelspec": book.metadata["kernelspec"]}
    return book


class Shown(Preprocessor):
    """Puts the cells of a notebook, with what they showed, before a line that only links to it."""

    def run(self, lines: list[str]) -> list[str]:
        """Lines of a page with the cells of its notebooks."""
        page = []
        for line in lines:
            if link := LINK.fullmatch(line):
                for cell in nbformat.read(GALLERY / link[1], as_version=4).cells:
                    page += self._cell(cell)
            page.append(line)
        return page

    def _cell(self, cell: nbformat.NotebookNode) -> list[str]:
        if cell.cell_type == "markdown":
            return [*cell.source.splitlines(), ""]
        outputs = [self.md.htmlStash.store(_html(output)) for output in cell.outputs]
        code = ["```python", *cell.source.splitlines(), "```", ""]
        return code + [line for output in outputs for line in (output, "")]


def _html(output: nbformat.NotebookNode) -> str:
    """What a cell showed: its richest form as a block of HTML."""
    shown = output.get("data", {"text/plain": output.get("text", "")})
    if "text/html" in shown:
        return f"<div>{shown['text/html']}</div>"
    if "image/png" in shown:
        image = shown["image/png"].strip()
        return f'<p><img alt="Figure of the cell above" src="data:image/png;base64,{image}"></p>'
    return f"<pre>{escape(shown['text/plain'])}</pre>"


class Notebooks(Extension):
    """What zensical.toml names."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register with a parser."""
        md.preprocessors.register(Shown(md), "notebooks", AFTER_WHITESPACE)


def makeExtension(**settings: object) -> Notebooks:
    """The extension, as Markdown looks for it."""
    return Notebooks(**settings)


if __name__ == "__main__":
    for path in sorted(GALLERY.glob("*.ipynb")):
        nbformat.write(executed(path), path)
