"""Build the documentation and fail unless every reference leads somewhere: python -m docs.build."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parent.parent
NOT_FOUND = "404.html"  # a server's page: from the root of a domain
FORMULA = re.compile(r"\\\((.*?)\\\)|\\\[(.*?)\\\]", re.DOTALL)  # as the generator leaves it
GREEK = "alpha beta gamma delta varepsilon zeta theta lambda mu pi rho sigma tau phi chi psi omega"
LETTERS = dict(zip(GREEK.split(), "αβγδεζθλμπρστφχψω", strict=True))
LETTERS |= {
    "Delta": "Δ",
    "Phi": "Φ",
    "Omega": "Ω",
    "Sigma": "Σ",
    "infty": "∞",
    "pm": "±",
    "le": "≤",
}
LETTERS |= {"ge": "≥", "times": "×", "sum": "Σ", "int": "∫", "approx": "≈", "to": "→"}
LETTERS |= {"propto": "∝", "sim": "~", "circ": "°", "dots": "…", "quad": " ", "qquad": " "}
LETTERS |= dict.fromkeys(("lVert", "rVert"), "‖") | dict.fromkeys(("lvert", "rvert"), "|")
LETTERS |= {name: name for name in ("cos", "sin", "tan", "max", "min", "arg")}
FRACTION = re.compile(r"\\t?frac\{([^{}]*)\}\{([^{}]*)\}")
ACCENTS = {
    "dot": "\u0307",
    "hat": "\u0302",
    "tilde": "\u0303",
    "bar": "\u0304",
}  # above what precedes
ACCENT = re.compile(r"\\(dot|hat|tilde|bar)\s*\{?(\w)\}?")
ENVIRONMENT = re.compile(r"\\(begin|end)\{\w+\}|\\\\|&amp;|[{}]|\\[,;! ]")
IN_CSS = re.compile(r"""(?:url\(|@import\s+(?!url\())\s*["']?([^"')\s]+)""")


class Page(HTMLParser):
    """A page's anchors, the places it links to, and what a browser loads with it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors = {""}
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take down what an element is called and where it leads."""
        at = {name: value or "" for name, value in attrs}
        self.anchors |= {at[name] for name in ("id", "name") if name in at}
        if "href" in at:
            (self.links if tag == "a" else self.loaded).add(at["href"])
        if "src" in at:
            self.loaded.add(at["src"])


def faults(site: Path) -> list[str]:
    """References of a built site that lead nowhere, and whatever is fetched from elsewhere."""
    pages = {path: Page(path) for path in sorted(site.rglob("*.html")) if path.name != NOT_FOUND}
    references = {(path, link, False) for path, page in pages.items() for link in page.links}
    references |= {(path, link, True) for path, page in pages.items() for link in page.loaded}
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        references |= {(sheet, link, True) for link in IN_CSS.findall(text)}
    return [
        f"{path.relative_to(site)}: {reference} {why}"
        for path, reference, loaded in sorted(references)
        if (why := _fault(reference, path, pages, loaded=loaded))
    ]


def _fault(reference: str, path: Path, pages: dict[Path, Page], *, loaded: bool) -> str:
    """What is wrong with a reference in a file; empty if nothing is."""
    parts = urlsplit(reference)
    if parts.scheme == "data":
        return ""
    if parts.scheme or parts.netloc:
        return "is fetched from elsewhere" if loaded else ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.is_file():
        return "is not in the site"
    if target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return "names no place of that page"
    return ""


def legible(formula: str) -> str:
    """A formula in TeX as plain characters, for where nothing typesets it."""
    text = re.sub(r"\\sqrt\{([^{}]*)\}", r"√(\1)", formula)
    text = FRACTION.sub(r"(\1)/(\2)", text)
    text = ACCENT.sub(lambda found: found[2] + ACCENTS[found[1]], text)
    text = re.sub(r"\^\{([^{}]{2,})\}", r"^(\1)", text)
    text = ENVIRONMENT.sub(" ", re.sub(r"_\{([^{}]*)\}", r"_\1", text))
    text = re.sub(r"\\([A-Za-z]+)", lambda found: LETTERS.get(found[1], ""), text)
    return " ".join(text.split())


def spell_out(site: Path) -> None:
    """Write the formulas of the search index as plain characters: results show them as they are."""
    index = json.loads((site / "search.json").read_text(encoding="utf-8"))
    for item in index["items"]:
        for part in ("title", "text"):
            item[part] = FORMULA.sub(lambda found: legible(found[1] or found[2]), item[part])
    text = json.dumps(index, ensure_ascii=False, separators=(",", ":"))
    (site / "search.json").write_text(text, encoding="utf-8")
    (site / "search.js").write_text(f"var __index = {text};", encoding="utf-8")


def build(root: Path) -> None:
    """Make root/site from root/zensical.toml; SystemExit says what is wrong."""
    generator = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    if subprocess.run(generator, cwd=root, check=False).returncode:
        raise SystemExit("the generator refuses the pages, see above")
    spell_out(root / "site")
    if found := faults(root / "site"):
        raise SystemExit("\n".join(found))


if __name__ == "__main__":
    build(ROOT)
