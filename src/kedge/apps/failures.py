"""What a failure is to who runs a command: one line and an exit code."""

import errno
import os
import sys
import traceback
from pathlib import Path
from typing import Any, NoReturn

import typer

import kedge
from kedge.apps.console import Interrupted, ThresholdMissed, interruptions, plain_warnings
from kedge.config.plugins import place_in_plugin
from kedge.core.errors import DataError, KedgeError

INPUT = 2
DEFECT = 70
"""An error in kedge itself (EX_SOFTWARE of sysexits.h): no input can be to blame."""
PACKAGE = str(Path(kedge.__file__).parent)
UsageError: type = typer.BadParameter.__bases__[0]
"""An option or argument that is unknown, missing or of no use."""
HINT = "--debug shows the traceback"


def explained(error: Exception) -> tuple[int, str]:
    """Exit code and message of what a command raised."""
    if isinstance(error, KedgeError):
        return INPUT, str(error)
    if isinstance(error, UsageError):
        return INPUT, _usage(error)
    what = _one_line(f"{type(error).__name__}: {error}")
    if place := place_in_plugin(error):
        return INPUT, f"{place}: {what} ({HINT})"
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in what:
        return INPUT, f"not enough memory: {what}; expected a smaller problem ({HINT})"
    if isinstance(error, OSError):
        # What is written to carries no name: a file that is open, or standard output.
        file = error.filename or "standard output or a file"
        return INPUT, f"{file}: {_one_line(error.strerror or str(error))} ({HINT})"
    frames = traceback.extract_tb(error.__traceback__)
    inside = [frame for frame in frames if frame.filename.startswith(PACKAGE)] or frames
    place = f" ({Path(inside[-1].filename).name}:{inside[-1].lineno})" if inside else ""
    return DEFECT, f"a defect of kedge: {what}{place}; {HINT}: please report it with that"


def flush_output(closed: bool) -> None:
    """Write out what was printed, while a failure can still be told.

    Raises:
        DataError: standard output is ``closed`` or full.
        BrokenPipeError: who read it has seen enough.
    """
    try:
        if closed:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        # Else the interpreter would try again at its end, and fail with a code of its own.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        raise DataError(f"standard output: cannot be written: {error.strerror}") from error


def run(command: Any) -> None:
    """Run the command line that was typed, by a Typer ``command``.

    Not as Typer itself does, which answers a mistyped option with a box of lines, and a reader
    that has seen enough (``kedge list | head``) with the exit code 1.
    """
    debug = "--debug" in sys.argv[1:]
    sys.argv[1:] = [argument for argument in sys.argv[1:] if argument != "--debug"]
    closed = sys.stdout is None
    if closed:
        sys.stdout = open(os.devnull, "w")
    try:
        with interruptions(), plain_warnings():
            try:
                with command.make_context("kedge", sys.argv[1:]) as context:
                    command.invoke(context)
            finally:
                flush_output(closed)
    except typer.Exit as error:
        sys.exit(error.exit_code)
    except ThresholdMissed as error:
        _end(3, str(error))
    except Interrupted as error:
        _end(130, f"interrupted; {error}")
    except BrokenPipeError:
        # Nothing is left to flush.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:
        if debug:
            traceback.print_exc()
        _end(*explained(error))


def _end(code: int, message: str) -> NoReturn:
    print(f"kedge: {message}", file=sys.stderr)
    sys.exit(code)


def _usage(error: Any) -> str:
    command = error.ctx.command_path if error.ctx else "kedge"
    message = " ".join(error.format_message().split())
    if type(error).__name__ == "NoArgsIsHelpError":
        # Its message is the help, and nothing was wrong.
        return f"expected a command; {command} --help lists them"
    return f"{message} ({command} --help)"


def _one_line(text: str, most: int = 300) -> str:
    line = text.strip().partition("\n")[0]
    return line if len(line) <= most else f"{line[:most]}..."
