"""What every command does alike: messages, exit codes, the log."""

import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from casid.errors import ConvergenceError, DataWarning

BAD_INPUT, NO_CONVERGENCE = 2, 3
ENDLESS = 10_000  # columns of a file or pipe


class _Unread(Console):
    """Goes on in silence where nobody reads any more (``casid identify study.toml | head``)."""

    def on_broken_pipe(self) -> None:
        """Write to nowhere: what is computed is kept, and the exit code tells of that alone."""
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())


def terminal() -> Console:
    """Standard output; lines are broken on a terminal only."""
    console = _Unread(highlight=False)
    if not console.file.isatty():
        console.width = ENDLESS
    return console


def new_table(title: str, first: str, *headings: str) -> Table:
    """An empty table with numbers to the right; a cell too narrow for its text is folded."""
    bold = Text(title, style="bold")
    made = Table(title=bold, title_justify="left", box=SIMPLE_HEAD, show_edge=False, padding=0)
    made.add_column(Text(first), overflow="fold")
    for heading in headings:
        made.add_column(Text(heading), justify="right", overflow="fold")
    return made


@contextmanager
def exits() -> Iterator[Console]:
    """A console; failures a user can do something about become messages and exit codes."""
    console = terminal()
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _told(console, warnings.showwarning)
            yield console
    except ConvergenceError as error:
        complain(console, "No convergence", error)
        sys.exit(NO_CONVERGENCE)
    except ValueError as error:
        complain(console, "Bad input", error)
        sys.exit(BAD_INPUT)
    except OSError as error:  # disk full, or a file that is no longer there or ours
        remedy = "earlier results are kept; make room or see to the file, then run the same again"
        complain(console, "Cannot read or write", f"{error}; {remedy}")
        sys.exit(BAD_INPUT)


def _told(console: Console, usual: Callable[..., None]) -> Callable[..., None]:
    """Shows warnings of data without the line of casid or click that they were issued for."""

    def show(message: Warning | str, category: type[Warning], *where: Any) -> None:  # noqa: ANN401
        if issubclass(category, DataWarning):
            caution(Console(stderr=True, highlight=False, width=console.width), str(message))
        else:
            usual(message, category, *where)

    return show


def caution(console: Console, said: str) -> None:
    """Print what a user should know."""
    console.print(Text("! ", style="bold yellow").append(said, style="default"))


def complain(console: Console, what: str, error: Exception | str) -> None:
    """Say on standard error what is wrong."""
    loud = Console(stderr=True, highlight=False, width=console.width)
    said = "\n".join(filter(None, [str(error), *getattr(error, "__notes__", ())]))
    text = Text(f"{what}: ", style="bold red").append(said, style="default")
    loud.print(text, soft_wrap=True)  # a path broken in two cannot be copied


@contextmanager
def logged(console: Console, verbose: bool) -> Iterator[None]:
    """Show what casid logs, if that is wanted."""
    logger = logging.getLogger("casid")
    # Without any handler, logging itself prints warnings, which are told as cautions anyway.
    handler: logging.Handler = logging.NullHandler()
    level = logger.level
    if verbose:
        handler = _LineHandler(lambda line: console.print(Text(f"  {line}", style="dim")))
        logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


class _LineHandler(logging.Handler):
    def __init__(self, write: Callable[[str], Any]) -> None:
        super().__init__()
        self._write = write

    def emit(self, record: logging.LogRecord) -> None:
        self._write(self.format(record))
