"""The command line: read, call, write.

`main` imports what it needs when it runs, so that an interrupt has its words from the first moment on.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import NoReturn

from bayes_rs.interrupts import EndedError, asked_to_end, check_goes_on, end, swallowed_in_silence, take_notice

EXIT_NOT_WHOLE = 1
EXIT_BAD_INPUT = 2
EXIT_FAULT = 70
"""A fault of the program, as ``sysexits.h`` counts."""
DEBUG = "BAYES_RS_DEBUG"
"""Environment variable: set to 1, every error shows its traceback before its line."""

_END = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_NOT_OURS = (signal.SIG_DFL, signal.default_int_handler)
_BY_SIGNAL = 128
"""What a shell adds to the number of the signal that ended a program."""
_BROKEN_PIPE = 13
_LONGEST = 300
"""Characters of an unknown error that are shown."""


def main() -> NoReturn:
    """Run the command line, whatever happens with one line on stderr, and end the process.

    The exit code is 0 for done, 1 for done with failures that are listed, 2 for bad input or what the machine has not
    got, 70 for a fault of the program, and 128 and the number of the signal for an end that was asked for.
    """
    take_notice()  # of what is past
    try:
        for number in _END:
            if signal.getsignal(number) in _NOT_OURS:  # who asks to live on, as nohup does, is heard
                with suppress(ValueError):  # a thread may not
                    signal.signal(number, end)
        with nullcontext() if os.environ.get(DEBUG) == "1" else swallowed_in_silence():
            code = _run()
            check_goes_on()
        for stream in (sys.stdout, sys.stderr):  # while an error there can have its words
            if stream is not None:
                stream.flush()
    except BaseException as error:  # noqa: BLE001 - the last resort
        code = _last_words(error)
    _leave(code)


def _run() -> int:
    from bayes_rs.cli.group import commands

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files need not be text
    output = sys.stdout
    try:
        code = commands.main(prog_name="bayes-rs", standalone_mode=False)
    except SystemExit as error:
        if sys.stdout is output:
            raise
        raise BrokenPipeError from error  # click ends without a word then, and puts something quiet in its place
    return code if isinstance(code, int) else 0


def _last_words(error: BaseException) -> int:
    """Say what ended the program, and what is kept; return the exit code."""
    import click

    if isinstance(error, click.Abort):
        error = error.__cause__ or error.__context__ or error
    if os.environ.get(DEBUG) == "1" and not isinstance(error, (click.ClickException, SystemExit)):
        with suppress(OSError, ValueError):
            traceback.print_exception(error)
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        error.show()
        return error.exit_code
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    words, code = _end_words(error) or _words(error)
    _say(words)
    for note in getattr(error, "__notes__", []):
        _say(note)
    return code


def _words(error: BaseException) -> tuple[str, int]:
    """Return what to say of an error, and the exit code."""
    import click

    from bayes_rs.errors import InputError, LostResultsError, MissingExtraError, WorkerError

    if isinstance(error, click.ClickException):
        return error.format_message(), EXIT_BAD_INPUT
    said = _one_line(error)
    if isinstance(error, MemoryError):
        said = f"the memory of this machine is not enough ({said or 'no more is given'})"
        return f"{said}: ask for less at a time, such as fewer workers, records or draws.", EXIT_BAD_INPUT
    if isinstance(error, RecursionError):
        return f"something that was given is nested too deeply{_where(error)}: give a flat one.", EXIT_BAD_INPUT
    if isinstance(error, LostResultsError):
        return said, EXIT_NOT_WHOLE
    if isinstance(error, OSError) and error.filename is None and error.strerror:
        said = f"{error.strerror}: see to it where the output goes, and run it again."
    if isinstance(error, (InputError, MissingExtraError, WorkerError, OSError)):
        return said or type(error).__name__, EXIT_BAD_INPUT
    what = f"this is a fault of bayes_rs, not yours: {type(error).__name__}{_where(error)}: {said[:_LONGEST]}"
    how = f"report this line, with the command and, if you can, its files; {DEBUG}=1 shows where it comes from"
    return f"{what}. Please {how}.", EXIT_FAULT


def _end_words(error: BaseException) -> tuple[str, int] | None:
    """Return the same of an end that was asked for, whatever a library made of it."""
    import click

    number = error.number if isinstance(error, EndedError) else asked_to_end()
    if number not in (None, signal.SIGINT):
        return f"ended by {signal.Signals(number).name}.", _BY_SIGNAL + number
    if number is not None or isinstance(error, (KeyboardInterrupt, EOFError, click.Abort)):
        return "interrupted.", _BY_SIGNAL + signal.SIGINT
    if isinstance(error, BrokenPipeError):
        return "who reads the output has gone (broken pipe).", _BY_SIGNAL + _BROKEN_PIPE
    return None


def _where(error: BaseException) -> str:
    """Return the last place in this package that an error came through."""
    package = str(Path(__file__).parents[1])
    frames = traceback.extract_tb(error.__traceback__)
    places = [frame for frame in frames if frame.filename.startswith(package) and frame.filename != __file__]
    if not places:
        return ""
    file = Path(places[-1].filename).relative_to(package).as_posix()
    return f" at {file}:{places[-1].lineno}"


def _one_line(error: BaseException) -> str:
    """Return what an error says without line breaks and control characters, which names and libraries bring along."""
    words = " ".join(str(error).split())
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in words)


def _say(words: str) -> None:
    from bayes_rs.cli.voice import error

    with suppress(OSError, ValueError):  # nobody may be there to read it
        error(f"bayes-rs: {words}")


def _leave(code: int) -> NoReturn:
    """End the process; what cannot be written any more is not tried again when the interpreter ends."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)
