"""The command line: what commands there are; each is imported when it is asked for."""

import gc
import sys
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import version
from typing import Any

import click

from casid.interrupts import end_interrupted

BAD_OUTPUT = 2  # exit code, as of bad input

COMMANDS: Mapping[str, tuple[str, str]] = {  # place, and what the list of commands says
    "bounds": ("study:bounds", "Compare the cases of a study's table [bounds], price bounds."),
    "check": ("study:check", "Check a study or a model file; estimate nothing."),
    "convert": ("conversion:convert", "Turn records, responses and fits into other tools' files."),
    "design": ("design:design", "Design the next flight of a study."),
    "identify": ("study:identify", "Identify the structure a study names and write its report."),
    "import": ("logs:import_command", "Turn a log (PX4, ArduPilot, TDMS) into a study."),
    "inspect": ("data:inspect_command", "Look at records before anything is identified."),
    "new-model": ("data:new_model_command", "Write a commented model file to start from."),
    "simulate": ("data:simulate", "Simulate a fitted model on a record and compare."),
}


class Commands(click.Group):
    """A group whose commands are imported late and all end alike when they are interrupted."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - as click has it
        """Names in alphabetical order."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in COMMANDS:
            return None
        ctx.invoked_subcommand = cmd_name  # an interruption of the import is one of the command
        module, _, name = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(import_module(f"casid.commands.{module}"), name)
        from casid.threads import limited  # noqa: PLC0415 - as late as the command

        ctx.with_resource(limited())
        gc.freeze()  # what is imported stays, and need not be looked through for garbage
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, said) for name, (_, said) in COMMANDS.items()])

    def main(self, *args: Any, **more: Any) -> Any:  # noqa: ANN401 - as click has it
        """Read the command line and run it; what cannot be printed, help too, is bad output."""
        try:
            return super().main(*args, **more)
        except OSError as error:
            click.echo(f"Cannot read or write: {error}", err=True)
            sys.exit(BAD_OUTPUT)

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 - as click has it
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            end_interrupted(ctx.invoked_subcommand)
        finally:
            gc.freeze()  # nor need what is left when the process ends


@click.group(
    cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(version("casid"))
def main() -> None:
    """Identify rotorcraft models from flight records, in the time and frequency domains.

    A study file (TOML) names the model structure, the records by role, the units of their channels
    and the options of each stage; paths in it are relative to the file.

    \b
    Exit codes: 0 success, 1 internal error, 2 bad input, 3 a solver did not converge,
    130 interrupted.
    """  # noqa: D301 - click's own mark for a paragraph left as it is
