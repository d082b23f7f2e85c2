"""Which options of reading the readers of some files use: one that none of them does is refused, not dropped."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from bayes_rs.errors import InputError, in_short
from bayes_rs.file_options import FileOptions
from bayes_rs.geometry.scan import Scan
from bayes_rs.options import about_option, options_of
from bayes_rs.readers.interface import OF_EVERY_FORMAT, OF_TEXT_FILES, Reader
from bayes_rs.readers.one_file import found_reader
from bayes_rs.readers.registry import READERS

_Options = TypeVar("_Options", bound=FileOptions)
NO_SCAN = Scan("none", np.array([[0.0, 0.0, 1.0]]), np.ones(1), np.zeros(1), scan_duration=1.0)
"""What stands for the scan where files are looked at for theirs."""


def check_used(files: Sequence[Path], scan: Scan | None, options: FileOptions) -> None:
    """Refuse an option that is given and that no reader of the files uses.

    Parameters
    ----------
    files : sequence of Path
        The files. They are opened only as far as options are given that not every format has, and are not yet found
        to be used; those that no reader recognises say nothing, and reading them says what is wrong.
    scan : Scan, optional
        The scan that they were measured with; None if it is looked for.
    options : FileOptions
        The caller's. What a scan's ``[file]`` table says is not asked for: the scan may have files of other formats.

    Raises
    ------
    InputError
        If there is one. The message says which formats use it.
    """
    asked = [name for name in options.given() if name not in OF_EVERY_FORMAT]
    unused, kinds = _unused(files, scan, options, asked)
    if unused and kinds:
        name = unused[0]
        value, flag = getattr(options, name), _flag(name)
        own = ", ".join(f"{kind} (file {str(file)!r})" for kind, file in kinds.items())
        users = [kind for kind, reader in READERS.items() if _uses(reader, name, is_text=True)]
        what = "files of text" if name in OF_TEXT_FILES else f"the format{'s' * (len(users) > 1)} {', '.join(users)}"
        more = f"; nor are {', '.join(unused[1:])}" if len(unused) > 1 else ""
        raise InputError(
            f"The option {name} {in_short(value)} ({flag}) is of {what}, and not used by the format of these files, "
            f"{own}{more}: leave it out, or say which format they have with file_format (--format)."
        )


def without_unused(files: Sequence[Path], scan: Scan | None, options: _Options, names: Collection[str]) -> _Options:
    """Return options without those of some names that no reader of the files uses: other files have them, too.

    Parameters
    ----------
    files, scan, options
        As for `check_used`.
    names : collection of str
        Options that other files have in common with these, such as the zone of a lidar's motion.
    """
    unused, kinds = _unused(files, scan, options, [name for name in options.given() if name in names])
    if not kinds:
        return options
    default = {entry.name: entry.default for entry in options_of(type(options))}
    return replace(options, **{name: default[name] for name in unused})


def _unused(
    files: Sequence[Path], scan: Scan | None, options: FileOptions, asked: Sequence[str]
) -> tuple[list[str], dict[str, Path]]:
    """Return those of the options that are used by no reader, and the formats that were found, each with a file."""
    left, kinds = list(asked), dict[str, Path]()
    for file in files:
        if not left:
            break
        try:
            reader, is_text = found_reader(file, scan or NO_SCAN, options)
        except (InputError, OSError):
            continue
        kinds.setdefault(reader.name, file)
        left = [name for name in left if not _uses(reader, name, is_text=is_text)]
    return left, kinds


def _uses(reader: Reader, name: str, *, is_text: bool) -> bool:
    if name == "time_zone":
        return not reader.in_utc
    if name in OF_EVERY_FORMAT or reader.uses is None:
        return True
    return name in reader.uses and (is_text or name not in OF_TEXT_FILES)


def _flag(name: str) -> str:
    """Return the name of an option on the command line."""
    own = about_option(FileOptions, name).flag
    return f"--{name.replace('_', '-')}" if own is None else own
