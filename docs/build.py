"""Build the documentation and fail unless every reference leads somewhere: python -m docs.build."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parent.parent
NOT_FOUND = "404.html"  # a server's page: from the root of a domain
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


def build(root: Path) -> None:
    """Make root/site from root/zensical.toml; SystemExit says what is wrong."""
    generator = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    if subprocess.run(generator, cwd=root, check=False).returncode:
        raise SystemExit("the generator refuses the pages, see above")
    if found := faults(root / "site"):
        raise SystemExit("\n".join(found))


if __name__ == "__main__":
    build(ROOT)
