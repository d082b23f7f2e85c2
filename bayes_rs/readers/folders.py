"""Files from what a user names: files, folders and patterns."""

from __future__ import annotations

import glob
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayes_rs.errors import InputError
from bayes_rs.readers.compressed import plain_suffix

TEMPORARY_SUFFIXES = (".tmp", ".temp", ".part", ".partial", ".crdownload", ".filepart", ".swp", ".bak")
UNFINISHED = (".partial-", ".replaced-")
"""In the name of a folder that a run of ours was writing when it was stopped; the last ``-`` may be left out."""
_WILD = "*?["


@dataclass(frozen=True)
class FoundFiles:
    """The files to read, and how many of a folder's were passed over, by the reason."""

    paths: tuple[Path, ...]
    passed_over: dict[str, int]


def find_files(files: str | Path | Sequence[str | Path], suffixes: Collection[str]) -> FoundFiles:
    """Find the files that `files` names.

    Parameters
    ----------
    files : str, Path or sequence of them
        Files; folders, searched with all folders in them; patterns such as ``2024-*/*.csv`` (``**`` for any folders).
    suffixes : collection of str
        Those that some reader reads: only such files are taken from a folder. A file that is named, or that a pattern
        matches, is taken whatever its suffix.

    Returns
    -------
    found : FoundFiles
        Files in the order named, those of a folder or pattern sorted by path; no file twice.

    Raises
    ------
    InputError
        If a file does not exist, or a folder or pattern gives no file.
    """
    named = [files] if isinstance(files, (str, Path)) else list(files)
    if not named:
        raise InputError("No file given: name at least one file with radial velocities.")
    paths: dict[Path, None] = {}
    passed_over = {"hidden": 0, "temporary": 0, "other_suffix": 0}
    for entry in named:
        path = Path(entry)
        if path.is_dir():
            found = []
            for file in sorted(file for file in path.rglob("*") if file.is_file()):
                reason = _passed_over(file.relative_to(path), suffixes)
                if reason:
                    passed_over[reason] += 1
                else:
                    found.append(file)
            if not found:
                raise InputError(
                    f"Folder {str(path)!r} has no file that can be read: its files are {_words(passed_over)}; the "
                    f"suffixes read are {', '.join(sorted(suffixes))}, also compressed."
                )
            paths.update(dict.fromkeys(found))
        elif path.is_file():
            paths[path] = None
        elif any(character in str(entry) for character in _WILD):
            matched = sorted(Path(file) for file in glob.glob(str(entry), recursive=True) if Path(file).is_file())  # noqa: PTH207 - Path.glob knows no absolute pattern
            if not matched:
                raise InputError(f"Pattern {str(entry)!r} matches no file: check the path and the pattern.")
            paths.update(dict.fromkeys(matched))
        else:
            raise InputError(f"File {str(path)!r} does not exist: check its path.")
    return FoundFiles(tuple(paths), passed_over)


def _passed_over(relative: Path, suffixes: Collection[str]) -> str:
    if any(part.startswith(".") for part in relative.parts):
        return "hidden"
    if any(mark in f"{part}-" for part in relative.parts[:-1] for mark in UNFINISHED):
        return "temporary"
    name = relative.name
    if name.endswith("~") or name.startswith("~$") or relative.suffix.lower() in TEMPORARY_SUFFIXES:
        return "temporary"
    return "" if plain_suffix(relative) in suffixes else "other_suffix"


def _words(passed_over: dict[str, int]) -> str:
    words = {"hidden": "hidden", "temporary": "temporary", "other_suffix": "with another suffix"}
    return ", ".join(f"{count} {words[reason]}" for reason, count in passed_over.items())
