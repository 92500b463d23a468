"""The command ``casid``: Ctrl-C and SIGTERM are caught before what takes time is imported."""

import io
import signal
import sys

from casid.interrupts import INTERRUPTED, Interrupt, end_interrupted


def main() -> None:
    """Run the command line; an interruption at any moment is one line and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # of a console that knows no ± or σ
    interrupt = Interrupt()
    signal.signal(signal.SIGINT, interrupt)
    sys.unraisablehook = interrupt.unraisable
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        from casid.cli import main as command  # noqa: PLC0415 - takes a second

        command(prog_name="casid")
    except SystemExit as end:
        if not interrupt.asked or end.code == INTERRUPTED:
            raise
    except BaseException:
        if not interrupt.asked:
            raise
    end_interrupted(next(iter(sys.argv[1:]), None))


if __name__ == "__main__":
    main()
