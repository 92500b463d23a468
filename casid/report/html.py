"""The report: one HTML page that needs nothing beside it."""

import base64
import gc
import gzip
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from urllib.parse import quote

import jinja2
from markupsafe import Markup
from matplotlib import rc_context

from casid.display import digits_beside_one
from casid.folder import Place, at_once
from casid.jobs.child_process import beside
from casid.report import intervals
from casid.report.answer import theil_place
from casid.report.content import TEMPLATES, Content, Drawing, Section, cautions, leads
from casid.report.drawings import save
from casid.report.interactive import interactive
from casid.report.look import LOOK
from casid.report.verdicts import word
from casid.report.words import costliest, number, percent, price, prior
from casid.textfile import write_text

PLOTLY = TEMPLATES / "plotly-basic.min.js.gz"  # plotly.js 4.1.1, MIT; see CONTRIBUTING
UNUSED, TAG = re.compile(r'<g id="[^"]*">'), re.compile(r"<[^>]*>")
PATH = re.compile(r'(?<= d=")M[^"A-KN-Y]*(?=")')  # of straight lines only
CODED = re.compile(r"[^\w !$'()*+,\-./:;<=>?@\[\]^{|}~]+", re.ASCII)  # in an address within quotes
POINT = re.compile(r"([MLz])(?:\s+([^\sMLz]+)\s+([^\sMLz]+))?")
LONG_DECIMALS = re.compile(r"(?<=\d\d\.\d)\d+")  # a tenth of a point is enough for a picture


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure as the page holds it: caption, static picture, interactive one if there is any."""

    name: str
    caption: str
    source: Markup
    plot: str | None = None  # base64 of compressed JSON


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A section as the page holds it."""

    name: str
    title: str
    body: Markup


def write_report(
    content: Content, sections: Sequence[Section], folder: str | Path, place: Place | None = None
) -> Path:
    """Write report.html and figures/*.svg, *.png too if asked for; returns the path of the page.

    ``place`` puts them beside other files of the result (`casid.folder.at_once`).
    """
    # The sections may come in any order; the folder is made if need be.
    if place is None:
        with at_once() as own:
            return write_report(content, sections, folder, own)
    folder = Path(folder)
    ordered = sorted(sections, key=lambda each: each.place)
    page = _environment().get_template("report.html.j2")
    drawings = {id(each): list(each.draw()) for each in ordered if each.title}
    every = [one for each in drawings.values() for one in each]
    pictures = _pictures(every, folder / "figures", place, png=content.png)
    chapters = [
        Chapter(name=each.name, title=each.title, body=body(each, content, own))
        for each in ordered
        if each.title
        for own in [[pictures[one.name] for one in drawings[id(each)]]]
    ]
    text = page.render(
        content=content,
        chapters=chapters,
        opening=[body(each, content) for each in ordered if each.template and not each.title],
        answers=[each.answer for each in ordered if each.answer],
        leads=leads(sections),
        cautions=cautions(content, sections),
        plotly=base64.b64encode(PLOTLY.read_bytes()).decode("ascii"),
    )
    write_text(place(folder / "report.html"), text)
    return folder / "report.html"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,  # names come from users' files
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "percent": percent, "price": price, "prior": prior}
    environment.filters["digits_beside_one"] = digits_beside_one
    environment.filters |= {"word": word, "place": theil_place, "bar": intervals.bar}
    environment.filters |= {"sigmas": intervals.sigma_place, "costliest": costliest}
    return environment


def body(section: Section, content: Content, pictures: Sequence[Picture] = ()) -> Markup:
    """A section's template, filled."""
    environment = _environment()
    drawn = environment.get_template("figures.html.j2").render(pictures=pictures)
    found = environment.from_string(section.template)
    values = {"content": content, "figures": lambda: Markup(drawn)} | dict(section.values)
    return Markup(found.render(values))


def _pictures(
    drawings: Sequence[Drawing], folder: Path, place: Place, *, png: bool
) -> dict[str, Picture]:
    """All drawings by name, every second one drawn in a process beside this one if that can be."""
    folder.mkdir(parents=True, exist_ok=True)
    ends = ("svg", "png") if png else ("svg",)
    own = [(each, [place(folder / f"{each.name}.{end}") for end in ends]) for each in drawings]
    with beside(partial(_drawn, own[1::2])) as other:
        pictures = [*_drawn(own[::2]), *other()]
    return {picture.name: picture for picture in pictures}


def _drawn(drawings: Sequence[tuple[Drawing, Sequence[Path]]]) -> list[Picture]:
    with rc_context(LOOK), _uncollected():
        return [_picture(drawing, *files) for drawing, files in drawings]


@contextmanager
def _uncollected() -> Iterator[None]:
    """No garbage is collected: figures are many objects that all stay, looked through in vain."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.unfreeze()  # as old as can be now: what is young is looked through soon
        if before:
            gc.enable()


def _picture(drawing: Drawing, svg: Path, png: Path | None = None) -> Picture:
    save(drawing, svg, png)
    plot = packed(interactive(drawing.figure)) if drawing.interactive else None
    source = address(svg.read_text(encoding="utf-8"))
    return Picture(name=drawing.name, caption=drawing.caption, source=source, plot=plot)


def packed(text: str) -> str:
    """A text compressed, in letters."""
    return base64.b64encode(gzip.compress(text.encode(), 6, mtime=0)).decode("ascii")


def address(svg: str) -> Markup:
    """A picture as the address of an image, for an attribute in double quotes."""
    text = LONG_DECIMALS.sub("", " ".join(svg.split()))
    text = UNUSED.sub("<g>", text).replace("; stroke-linecap: square", "")
    text = PATH.sub(lambda path: relative(path[0]), text)
    # What is in single quotes need not be escaped.
    text = TAG.sub(lambda tag: tag[0].replace("'", "").replace('"', "'"), text)
    return Markup(f"data:image/svg+xml,{CODED.sub(lambda found: quote(found[0]), text)}")


def relative(path: str) -> str:
    """A path of straight lines by its steps in tenths of a point, which take half the letters."""
    said, before, at = "", "", (0, 0)
    for letter, x, y in POINT.findall(path):
        if letter != "z":
            there = round(10 * float(x)), round(10 * float(y))
            step = there if letter == "M" else (there[0] - at[0], there[1] - at[1])
            # What follows a move without a letter is a line to it.
            said += " " if letter == before == "L" else letter.replace("L", "l")
            said += f"{_tenths(step[0])} {_tenths(step[1])}"
            at = there
        else:
            said += letter
        before = letter
    return said.replace(" -", "-")


@cache
def _tenths(n: int) -> str:
    """A number of tenths as a decimal, in few letters."""
    return f"{n / 10:g}".replace("0.", "." if abs(n) < 10 else "0.")
