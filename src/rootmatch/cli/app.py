"""The application: its commands, its exit codes, and errors as one line on standard error.

Exit codes: 0 success, 1 an answer that should not be trusted, 2 bad input, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from rootmatch._version import __version__
from rootmatch.cli.benchmark import benchmark
from rootmatch.cli.match import match
from rootmatch.cli.reproduce import reproduce
from rootmatch.cli.simulate import simulate
from rootmatch.errors import RootmatchError

BAD_INPUT = 2
INTERRUPTED = 130
STOPPED = "interrupted; nothing half-written is left"

COMMANDS: dict[str, Callable[..., None]] = {
    "match": match,
    "simulate": simulate,
    "reproduce": reproduce,
    "benchmark": benchmark,
}
"""The commands by name. Their modules import what is heavy inside the function, so that help stays instant."""


class OneLineErrors(TyperGroup):
    """A group of commands that says every error in one line and never shows a traceback of a user's mistake."""

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run, and leave with the exit code."""
        extra["standalone_mode"] = False
        try:
            code = super().main(*args, **extra)
            sys.stdout.flush()
        except (KeyboardInterrupt, typer.Abort):
            sys.exit(_fail(STOPPED, INTERRUPTED))
        except RootmatchError as error:
            sys.exit(_fail(str(error), BAD_INPUT))
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # whoever read it has gone; no more is said
            sys.exit(BAD_INPUT)
        except Exception as error:
            if _interrupted(error):
                sys.exit(_fail(STOPPED, INTERRUPTED))
            # The parser's own errors of usage; everything else is a fault of the program and shows where it is.
            if not hasattr(error, "format_message"):
                raise
            # Without a text the parser has shown the help instead.
            sys.exit(_fail(_usage(error), BAD_INPUT) if error.format_message() else BAD_INPUT)
        sys.exit(_fail(STOPPED, code) if code == INTERRUPTED else code or 0)


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C lies behind an error: met while a compiled function returns, it comes out as a SystemError."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _usage(error: Any) -> str:
    """The text of an error of usage, with the command whose help says more."""
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "rootmatch"
    return f"{error.format_message().rstrip('.')}; see {command} --help"


def _fail(text: str, code: int) -> int:
    """Say what is wrong, in one line however the text was made, and give back the exit code."""
    print(f"rootmatch: {' '.join(text.split())}", file=sys.stderr)
    return code


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rootmatch {__version__}")
        raise typer.Exit


app = typer.Typer(
    cls=OneLineErrors,
    name="rootmatch",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Which point is which, when nothing but geometry is known.",
)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Which point is which, when nothing but geometry is known."""


def main() -> None:
    """Entry point of the command ``rootmatch``."""
    app(prog_name="rootmatch")
