"""Markdown tables of the benchmarks."""


def table(header, rows):
    """Markdown table; numbers to three significant digits."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(map(cell, row)) + " |" for row in rows]
    return "\n".join(lines)


def cell(value):
    """Text as it is, a number to three significant digits."""
    return value if isinstance(value, str) else f"{value:.3g}"


def against(value, limit, *, above=False, digits=3):
    """A figure with its target and whether it holds."""
    holds = value >= limit if above else value <= limit
    return f"{value:.{digits}g} ({'≥' if above else '≤'} {limit:g}: {'yes' if holds else 'NO'})"
