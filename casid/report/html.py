"""The report: one HTML page that needs nothing beside it."""

import base64
import gzip
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
from markupsafe import Markup
from matplotlib import rc_context
from plotly.offline import get_plotlyjs

from casid.files import write_text
from casid.report import intervals
from casid.report.answer import place
from casid.report.content import TEMPLATES, Caution, Content, Drawing, Section
from casid.report.drawings import save
from casid.report.interactive import interactive
from casid.report.look import LOOK
from casid.report.verdicts import word
from casid.report.words import costliest, number, percent, price, prior

LONG_DECIMALS = re.compile(r"(\d\d\.\d)\d+")  # a tenth of a point is enough for a picture


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure as the page holds it: caption, static picture, interactive one if there is any."""

    name: str
    caption: str
    source: str
    plot: Markup | None = None


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A section as the page holds it."""

    name: str
    title: str
    body: Markup


def write_report(content: Content, sections: Sequence[Section], folder: str | Path) -> Path:
    """Write report.html and figures/*.png, *.svg; returns the path of the page."""
    # The sections may come in any order; the folder is made if need be.
    folder = Path(folder)
    ordered = sorted(sections, key=lambda each: each.place)
    page = _environment().get_template("report.html.j2")
    chapters = [
        _chapter(section, content, folder / "figures") for section in ordered if section.title
    ]
    packed = gzip.compress(get_plotlyjs().encode(), mtime=0)  # the library, to four tenths
    text = page.render(
        content=content,
        chapters=chapters,
        opening=[body(each, content) for each in ordered if each.template and not each.title],
        answers=[each.answer for each in ordered if each.answer],
        leads=[section.lead for section in sections if section.lead],
        cautions=cautions(content, sections),
        plotly=base64.b64encode(packed).decode("ascii"),
    )
    write_text(folder / "report.html", text)
    return folder / "report.html"


def cautions(content: Content, sections: Sequence[Section]) -> tuple[str, ...]:
    """What makes the result less certain than it looks, what matters most first."""
    said = [caution for section in sections for caution in section.cautions]
    said += [Caution(text) for text in content.warnings]
    return tuple(dict.fromkeys(each.text for each in sorted(said, key=lambda each: each.rank)))


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,  # names come from users' files
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "price": price, "prior": prior}
    environment.filters |= {"word": word, "place": place, "bar": intervals.bar}
    environment.filters |= {"sigmas": intervals.place, "costliest": costliest}
    return environment


def body(section: Section, content: Content, pictures: Sequence[Picture] = ()) -> Markup:
    """A section's template, filled."""
    environment = _environment()
    drawn = environment.get_template("figures.html.j2").render(pictures=pictures)
    found = environment.from_string(section.template)
    values = {"content": content, "figures": lambda: Markup(drawn)} | dict(section.values)
    return Markup(found.render(values))


def _chapter(section: Section, content: Content, folder: Path) -> Chapter:
    with rc_context(LOOK):
        pictures = [_picture(drawing, folder) for drawing in section.draw()]
    text = body(section, content, pictures)
    return Chapter(name=section.name, title=section.title, body=text)


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
