"""The application: its commands, and errors as one line on standard error."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from rootmatch._version import __version__
from rootmatch.cli.benchmark import benchmark
from rootmatch.cli.error_messages import print_brief_warnings
from rootmatch.cli.exit_codes import BAD_INPUT, INTERRUPTED, READER_GONE, TERMINATED
from rootmatch.cli.match import match
from rootmatch.cli.reproduce import reproduce
from rootmatch.cli.simulate import simulate
from rootmatch.cli.surroundings import (
    NOTHING_LEFT,
    copy_pipes,
    describe_stop,
    discard_output,
    note_remainder,
    prepare_streams,
)
from rootmatch.cli.track import track
from rootmatch.cli.warmup import warmup
from rootmatch.errors import RootmatchError, escape_unprintable

_OVERLONG = re.compile(r"\S{300,}")
"""A word too long for a line of error: longer than the path of a file usually is."""

COMMANDS: dict[str, Callable[..., None]] = {
    "match": copy_pipes("model", "image")(match),
    "track": copy_pipes("model")(track),
    "simulate": simulate,
    "reproduce": reproduce,
    "benchmark": benchmark,
    "warmup": warmup,
}
"""The commands by name. Their modules import heavy packages inside the function, so that help stays instant."""


class ReaderGoneError(Exception):
    """Standard output has no reader any more. Under its own name the parser would end the program with 1."""


@contextmanager
def _rename_broken_pipe() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError as error:
        raise ReaderGoneError from error


class OneLineErrors(TyperGroup):
    """A command group that reports every error in one line and shows no traceback for a user's mistake."""

    def make_context(self, *args: Any, **extra: Any) -> Any:
        """Parse the command line, and print the help."""
        with _rename_broken_pipe():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        with _rename_broken_pipe(), print_brief_warnings():
            try:
                return super().invoke(ctx)
            finally:
                sys.stdout.flush()

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run a command and exit with its code."""
        extra["standalone_mode"] = False
        note_remainder(NOTHING_LEFT)
        try:
            code = super().main(*args, **extra)
        except (KeyboardInterrupt, typer.Abort) as error:
            if isinstance(error.__cause__, EOFError):  # to the parser Ctrl-D at a prompt, and there is none here
                raise error.__cause__ from None
            sys.exit(report_stop())
        except RootmatchError as error:
            sys.exit(_fail(str(error), BAD_INPUT))
        except ReaderGoneError:
            discard_output()
            sys.exit(READER_GONE)
        except OSError as error:
            discard_output()
            where = error.filename or "standard output"
            sys.exit(_fail(f"{where}: {error.strerror or error}; free or choose another place", BAD_INPUT))
        except Exception as error:
            if _is_interrupt(error):
                sys.exit(report_stop())
            # Usage errors come from the parser; anything else is a bug and keeps its traceback.
            if not hasattr(error, "format_message"):
                raise
            # Without a message the parser has already printed the help.
            sys.exit(_fail(_usage_text(error), BAD_INPUT) if error.format_message() else BAD_INPUT)
        sys.exit(report_stop() if code == INTERRUPTED else code or 0)


def report_stop() -> int:
    """Say that a signal ended the work, and return its exit code."""
    terminated, left = describe_stop()
    return _fail(f"terminated; {left}", TERMINATED) if terminated else _fail(f"interrupted; {left}", INTERRUPTED)


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: if it strikes while a compiled function returns, it surfaces as SystemError."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _usage_text(error: Any) -> str:
    """Text of a usage error, with the command whose help says more."""
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "rootmatch"
    text = error.format_message().replace(": Value error, ", ": ").rstrip(".")  # the parser's own way to say it
    option = re.fullmatch(r"No such command '(diagnose|plot|report)'", text)
    if option:
        return f"{text}; it is an option: see rootmatch match --help, --{option[1]}"
    return f"{text}; see {command} --help"


def _fail(text: str, code: int) -> int:
    """Print an error in one line, whatever its line breaks, and return the exit code."""
    with suppress(OSError):
        print(f"rootmatch: {_OVERLONG.sub(_shorten, escape_unprintable(' '.join(text.split())))}", file=sys.stderr)
    return code


def _shorten(word: re.Match[str]) -> str:
    return f"{word[0][:80]}...{word[0][-80:]}"


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
    help="Find out which detection is which point, and the pose, from geometry alone.",
)
for _name, _command in COMMANDS.items():
    app.command(_name)(_command)


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Find out which detection is which point, and the pose, from geometry alone."""


def main() -> None:
    """Entry point of the command ``rootmatch``."""
    prepare_streams()
    app(prog_name="rootmatch")
