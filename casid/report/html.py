"""The report: one HTML page that needs nothing beside it."""

import base64
import gzip
import re
from dataclasses import dataclass, fields
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from casid.eigenmodes import modes
from casid.files import write_text
from casid.fit import ParameterEstimate
from casid.report.content import Content
from casid.report.drawings import Drawing, draw, save
from casid.report.interactive import interactive
from casid.report.verdicts import cautions, coloured, verdicts, word

LONG_DECIMALS = re.compile(r"(\d\d\.\d)\d+")  # a tenth of a point is enough for a picture

SECTIONS = {
    "responses": "Frequency responses",
    "histories": "Time histories of unseen records",
    "rms": "RMS errors",
    "whiteness": "Residuals",
    "match": "Match",
    "black_box": "Black box",
    "modes": "Modes",
    "bounds": "Comparison of bounds",
}


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure as the page holds it: caption, static picture, interactive one if there is any."""

    name: str
    caption: str
    source: str
    plot: Markup | None = None


def write_report(content: Content, folder: str | Path) -> Path:
    """Write report.html and figures/*.png, *.svg; returns the path of the page."""
    folder = Path(folder)
    pictures: dict[str, list[Picture]] = {section: [] for section in SECTIONS}
    for drawing in draw(content):
        pictures[drawing.section].append(_picture(drawing, folder / "figures"))
    page = folder / "report.html"
    write_text(page, render(content, pictures))
    return page


def render(content: Content, pictures: dict[str, list[Picture]]) -> str:
    """Return the page's text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("casid.report"),
        autoescape=True,  # names come from users' files
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "price": price, "word": word}
    model = content.output_error.model
    return environment.get_template("report.html.j2").render(
        content=content,
        pictures=pictures,
        verdicts=verdicts(content),
        cautions=cautions(content),
        plotly=_compressed(get_plotlyjs()),
        modes={name: modes(fit.model.system()) for name, fit in content.fits.items()},
        units=content.units,
        coloured=coloured(content.output_error),
        structure=type(model),
        trim={
            name: getattr(model, name)
            for name in (f.name for f in fields(model))
            if name not in type(model).infos()
        },
    )


def number(value: float | None, digits: int = 4) -> str:
    """A number as a reader wants it: four digits, no needless exponent, a dash for NaN."""
    if value is None or np.isnan(value):
        return "–"
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}e{int(exponent)}"
    return text.replace("-", "−")


def percent(row: ParameterEstimate) -> str:
    """Standard error in percent of the value."""
    if not np.isfinite(row.std_error) or row.value == 0 or row.fixed:
        return "–"
    share = 100 * row.std_error / abs(row.value)
    return f"{share:.1f}" if share < 999.5 else "> 999"


def price(row: ParameterEstimate) -> str:
    """Price of the bound a parameter lies on."""
    return number(row.multiplier, 3) if row.active else ""


def _compressed(text: str) -> str:
    """Text as gzip in base64: the plotting library shrinks to four tenths."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def _picture(drawing: Drawing, folder: Path) -> Picture:
    _, svg = save(drawing, folder)
    text = LONG_DECIMALS.sub(r"\1", " ".join(svg.read_text(encoding="utf-8").split()))
    data = base64.b64encode(text.encode()).decode("ascii")
    source = f"data:image/svg+xml;base64,{data}"
    plot = None
    if drawing.interactive:
        # A closing tag within the data must not end the element that holds them.
        plot = Markup(interactive(drawing.figure).replace("<", "\\u003c"))
    return Picture(name=drawing.name, caption=drawing.caption, source=source, plot=plot)
