"""Ctrl-C: what it sets off, and how a command ends after it."""

import signal
import sys
from collections import namedtuple
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130  # exit code, as of a shell
KEEPING = ("identify", "bounds")  # commands that keep what had ended, and go on from there


class Interrupt:
    """A handler of SIGINT that remembers its call: others may swallow the exception it raises."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, _: int, __: FrameType | None) -> None:
        """Remember, and raise KeyboardInterrupt."""
        self.asked = True
        raise KeyboardInterrupt

    @staticmethod
    def unraisable(lost: "sys.UnraisableHookArgs") -> None:
        """Say nothing of a call where Python cannot raise, as after a fork: it is remembered."""
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(lost)


def check_interrupt() -> None:
    """Raise the KeyboardInterrupt that somebody has swallowed."""
    handler = signal.getsignal(signal.SIGINT)
    if isinstance(handler, Interrupt) and handler.asked:
        raise KeyboardInterrupt


def end_interrupted(command: str | None) -> NoReturn:
    """End the process, once and with one line; in somebody else's, SIGINT stays as it is."""
    if isinstance(signal.getsignal(signal.SIGINT), Interrupt):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    kept = "; what had ended is kept, the same command goes on" * (command in KEEPING)
    # An interruption of code that Python made of text, such as a data class's, lets `python -m` end
    # by the signal whatever its exit code, unless other such code has ended well since.
    namedtuple("Text", ())
    print(f"Interrupted{kept}.", file=sys.stderr)  # noqa: T201 - rich may not be there yet
    sys.exit(INTERRUPTED)
