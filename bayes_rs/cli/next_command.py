"""The command to type next, for a person to copy."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_rs.file_options import FileOptions
from bayes_rs.options import options_of

_MOST_FILES = 4


def reading_words(options: Mapping[str, Any]) -> list[str]:
    """Return the options of reading that a command was given, as words of a command line."""
    words: list[str] = []
    for entry in options_of(FileOptions):
        value = options.get(entry.name)
        if value is None or value in ((), {}) or not entry.flag:
            continue
        if entry.name in ("range", "height"):
            words += [entry.flag, value if isinstance(value, str) else ",".join(f"{one:g}" for one in value)]
            continue
        several = value.items() if isinstance(value, Mapping) else value
        for one in several if isinstance(value, (Mapping, list, tuple)) else [value]:
            words += [entry.flag, "=".join(map(str, one)) if isinstance(one, tuple) else f"{one}"]
    return words


def files_words(given: Sequence[str], files: Sequence[Path], others: Sequence[Path]) -> list[str] | None:
    """Return words that name files and no others: what was given, a pattern, or the files themselves.

    Parameters
    ----------
    given : sequence of str
        What the command was given, which names `files` and `others`.
    files, others : sequence of Path
        The files that are meant, and those that are not.

    Returns
    -------
    words : list of str or None
        None if it takes more words than a person would copy.
    """
    if not others:
        return list(given)
    folder = Path(os.path.commonpath([str(file.parent) for file in files]))
    for part in re.split(r"[_.\s-]+", files[0].stem):
        if part and all(part in file.name for file in files) and not any(part in file.name for file in others):
            if all(file.parent == folder for file in files):
                return [str(folder / f"*{part}*")]
            return [str(folder / "**" / f"*{part}*")]
    return [str(file) for file in files] if len(files) <= _MOST_FILES else None


def command_line(*words: str) -> str:
    """Return words as a shell takes them."""
    return " ".join(shlex.quote(word) for word in words)
