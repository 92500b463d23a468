"""Tables of studies as text: CSV for programs, Markdown for readers."""

import csv
import io
from collections.abc import Sequence
from typing import Any


def csv_text(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Rows below a header; numbers to ten digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_plain(value) for value in row] for row in rows)
    return text.getvalue()


def markdown_table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of cells that are text already."""
    escaped = [[cell.replace("|", "\\|") for cell in row] for row in (heading, *rows)]
    first, *others = ["| " + " | ".join(row) + " |" for row in escaped]
    return "\n".join([first, "|" + "---|" * len(heading), *others])


def _plain(value: Any) -> str:  # noqa: ANN401 - a cell
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else str(value)
