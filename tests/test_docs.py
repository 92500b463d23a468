"""Every code block of the documentation is run, page by page, in the order of the page.

Blocks of one page share a namespace and a folder of their own, in which `examples` and `models` of
the repository lie. By the word after the fence:

- ``python`` is executed;
- a block with ``title="file"`` is written to that file;
- ``sh`` is run, line by line: ``casid`` in a process of its own, ``make`` by looking the target up
  in the Makefile; git, cd, pip and source belong to an installation, which `.ci/run` does in full;
- ``text`` right after one of these is its output: words must be those printed, numbers agree to
  5 %, ``...`` stands for anything;
- ``toml`` must at least be TOML;
- ``console`` (a command with the output it once gave), ``csv``, and ``text`` elsewhere are
  pictures: run by nobody, so quote there only what takes too long or differs every time.

All pages together are to cost less than 90 s of one core: use short records and few frequencies.
"""

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import tomllib
import warnings
from pathlib import Path

import griffe
import matplotlib as mpl
import pytest
from markdown_it import MarkdownIt

import casid
import casid.report
from casid import DataWarning

ROOT = Path(__file__).parent.parent
PAGES = (*sorted((ROOT / "docs").rglob("*.md")), ROOT / "CONTRIBUTING.md")
LONG = (
    "flight",
    "envelope",
    "dask",
    "weights",
    "units",
    "bounds",
    "exchange",
    "autopilot",
    "turbulence",
)  # pages whose examples take long and stand in other tests too
SNIPPET = re.compile(r'^--8<-- "(.+)"$')
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", flags=re.IGNORECASE)
INSTALLING = ("git", "cd", "pip", "source")
TOLERANCE = 0.05  # relative, of shown numbers: another machine's rounding must not turn a page red


def blocks_of(page):
    """(line, language, title, text, whether it follows the block before it at once) of a page."""
    tokens = MarkdownIt().parse(page.read_text(encoding="utf-8"))
    end = -1
    for token in tokens:
        assert token.type != "code_block", f"{page}:{token.map[0] + 1}: indented block; fence it"
        if token.type != "fence":
            continue
        language, _, rest = token.info.partition(" ")
        title = re.search(r'title="([^"]+)"', rest)
        text = token.content
        if snippet := SNIPPET.match(text.strip()):
            text = (ROOT / snippet[1]).read_text(encoding="utf-8")
        follows = token.map[0] - end <= 1
        yield token.map[0] + 1, language, title and title[1], text, follows
        end = token.map[1]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A page's own folder, with the repository's examples and models in it."""
    for name in ("examples", "models"):
        shutil.copytree(ROOT / name, tmp_path / name, copy_function=os.symlink)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=pytest.mark.campaign) if p.stem in LONG else p for p in PAGES],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_every_block_of_a_page_does_what_it_says(page, folder):
    mpl.use("Agg")
    names = {"__name__": "page"}
    printed = None
    for line, language, title, text, follows in blocks_of(page):
        where = f"{page.relative_to(ROOT)}:{line}"
        if language == "text" and follows and printed is not None:
            assert_shows(text, printed, where)
        printed = None
        if title is not None:
            written = folder / title
            written.parent.mkdir(parents=True, exist_ok=True)
            if not written.exists():
                written.write_text(text, encoding="utf-8")
        else:
            printed = RUN[language](text, names, where)


def look(_text, _names, _where):
    """Do nothing: a picture."""


def parse(text, _names, _where):
    """Fail unless a block is TOML."""
    tomllib.loads(text)


def run_python(text, names, where):
    """Output of a block executed in the page's namespace."""
    code = compile("\n" * int(where.rpartition(":")[2]) + text, where, "exec")
    output = io.StringIO()
    with contextlib.redirect_stdout(output), warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # part of what a reader sees
        exec(code, names)
    return output.getvalue()


def run_shell(text, _names, where):
    """Output of a block's commands; what only installs or builds is looked up."""
    output = []
    for line in text.splitlines():
        command, *arguments = line.partition("#")[0].split()
        if command == "make":
            makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
            for target in arguments:
                assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), f"{where}: {line}"
        elif command == "casid":
            program = Path(sys.executable).parent / command
            run = subprocess.run(
                [str(program), *arguments], capture_output=True, text=True, check=False,
                env=os.environ | {"COLUMNS": "100"},
            )  # fmt: skip
            assert run.returncode == 0, f"{where}: {line}\n{run.stdout}{run.stderr}"
            output.append(run.stdout)
        else:
            assert command in INSTALLING, f"{where}: {line!r} is run by nobody"
    return "".join(output)


RUN = {
    "python": run_python, "sh": run_shell, "toml": parse,
    "text": look, "console": look, "csv": look, "diff": look,
}  # fmt: skip


def assert_shows(shown, printed, where):
    """Fail unless the output shown is the one printed; a line of ... stands for any lines."""
    lines = [line for line in printed.splitlines() if line.strip()]
    skipping = False
    for line in shown.splitlines():
        if not line.strip():
            continue
        if line.strip() == "...":
            skipping = True
            continue
        while lines and skipping and not alike(line, lines[0]):
            lines.pop(0)
        assert lines, f"{where}: {line!r} is not in the output:\n{printed}"
        assert alike(line, lines[0]), f"{where}: shown {line!r}, printed {lines[0]!r}\n{printed}"
        lines.pop(0)
        skipping = False
    assert skipping or not lines, f"{where}: the output goes on:\n{printed}"


def alike(shown, printed):
    """Whether two lines agree in their words, and in their numbers to a few per cent."""
    numbers = [NUMBER.findall(line) for line in (shown, printed)]
    words = [re.sub(r"[\s─-╿]+", " ", NUMBER.sub("#", line)).strip() for line in (shown, printed)]
    if "..." in words[0]:
        pattern = ".*".join(re.escape(part) for part in words[0].split("..."))
        return re.fullmatch(pattern, words[1]) is not None
    if words[0] != words[1]:
        return False
    pairs = [
        [float(text.replace("−", "-")) for text in pair] for pair in zip(*numbers, strict=True)
    ]
    return all(abs(a - b) <= TOLERANCE * max(abs(a), abs(b)) + 1e-12 for a, b in pairs)


def test_every_page_stands_in_the_table_of_contents():
    def listed(entries):
        for entry in entries:
            (under,) = entry.values()
            yield from [under] if isinstance(under, str) else listed(under)

    site = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))
    pages = [str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed(site["project"]["nav"])) == sorted(pages)


def test_pages_and_examples_import_what_is_public():
    texts = [page.read_text("utf-8") for page in (*PAGES, ROOT / "README.md")]
    texts += [program.read_text("utf-8") for program in (ROOT / "examples").glob("*.py")]
    assert not re.findall(r"^\s*(?:from|import) casid\..*$", "\n".join(texts), flags=re.MULTILINE)


def test_every_public_name_stands_in_the_reference():
    reference = "".join(page.read_text("utf-8") for page in (ROOT / "docs/reference").glob("*.md"))
    shown = set(re.findall(r"^::: casid\.(?:[\w.]+\.)?(\w+)$", reference, flags=re.MULTILINE))
    shown |= set(re.findall(r"`(\w+)`", reference))  # types and constants, in a sentence
    assert set(casid.__all__) <= shown
    assert set(casid.report.__all__) <= shown


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_rows_of_a_table_have_as_many_cells_as_its_head(page):
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    for table in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        bare = re.sub(r"`[^`\n]*`|\\\|", "", table)
        assert len({row.count("|") for row in bare.splitlines()}) == 1, table


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_formulas_are_written_to_be_typeset(page):
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`\n]*`|\$[^$]+\$|\$\$[^$]+\$\$", "", text)
    prose = re.sub(
        r"^\|.*$", "", text, flags=re.MULTILINE
    )  # tables may be as a command prints them
    assert re.findall(r".*(?:[λμωγΦ√∞‖⁻₀∝∂∘∑½]|\w[\u0302\u0303]).*", prose) == []


@pytest.mark.second
def test_parameters_that_share_an_entry_keep_their_own_types_and_defaults():
    own_types = griffe.load_extensions("dataclasses", str(ROOT / "docs/own_types.py"))
    package = griffe.load("casid", search_paths=[ROOT], extensions=own_types,
                          docstring_parser="numpy",
                          docstring_options={"warnings": False})  # fmt: skip
    sections = package["matching.match.match"].docstring.parsed
    (rows,) = (each.value for each in sections if each.kind.value == "parameters")
    shown = {row.name: (str(row.annotation), str(row.value)) for row in rows}
    assert shown["fixed"] == ("Collection[str]", "()")
    assert shown["bounds"] == ("Bounds | None", "None")


def test_output_shown_is_compared_by_words_and_by_numbers():
    assert alike("a 1.00 b", "a  1.04  b")
    assert not alike("a 1.00 b", "a 1.10 b")
    assert not alike("a 1.00 b", "c 1.00 b")
    assert alike("total ... s", "total 12.5 of 3 s")
    assert_shows("a 1\n...\nz\n", "a 1\nb\nc\nz\n", "here")
    with pytest.raises(AssertionError, match="the output goes on"):
        assert_shows("a 1\n", "a 1\nb\n", "here")
    with pytest.raises(AssertionError, match="is not in the output"):
        assert_shows("...\nz\n", "a 1\n", "here")
