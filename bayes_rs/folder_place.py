"""Which folder may be replaced, and how another one takes its place: only what we wrote is ever removed."""

from __future__ import annotations

import glob
import hashlib
import os
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayes_rs.errors import InputError
from bayes_rs.ledger import HALF, LEDGER, Ledger, fingerprint_of, fingerprint_of_file, read_ledger

MARK = f"{HALF}partial"
"""File in a folder that a run fills beside the one that it replaces: a folder that only has such a name has it not."""
_STEM = 40
"""Characters of a long name in the names beside it."""
_WINDOWS = sys.platform == "win32"
_DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{number}" for port in ("COM", "LPT") for number in range(1, 10))}
_NO_NAME = '<>:"|?*'
_LONGEST = 200  # bytes: any file system takes the name and what we add to it


def partial_of(final: Path) -> Path:
    """Return the folder in which a run writes that is to replace `final`: always the same, so that it is found."""
    return final.parent / f"{_stem(final)}.partial"


def replaced_of(final: Path) -> Path:
    """Return the hidden name that the old folder has while the new one takes its place."""
    return final.parent / f".{_stem(final)}.replaced"


def _stem(final: Path) -> str:
    encoded = os.fsencode(final.name)
    if len(encoded) <= _LONGEST:
        return final.name
    return f"{final.name[:_STEM]}-{hashlib.sha256(encoded).hexdigest()[:8]}"


def check_place(final: Path) -> None:
    """Refuse a folder whose name is taken by a link or by a file.

    Raises
    ------
    InputError
        If it is.
    OSError
        If the name cannot be, as one that is too long.
    """
    if _WINDOWS:
        check_windows_name(final.name)
    with suppress(FileNotFoundError, NotADirectoryError):
        final.lstat()  # says what is wrong with a name; from Python 3.14 on, `exists` says no and nothing more
    if final.is_symlink():
        raise InputError(f"Cannot write the output folder {str(final)!r}: it is a link; give the folder itself.")
    if final.exists() and not final.is_dir():
        raise InputError(
            f"Cannot write the output folder {str(final)!r}: a file of that name exists; give another name."
        )


def check_windows_name(name: str) -> None:
    """Refuse the name of a folder that Windows takes for a device, cuts, or puts into a hidden stream of another file.

    Raises
    ------
    InputError
        If it is one.

    Examples
    --------
    >>> check_windows_name("year-2020")
    """
    if name.split(".", maxsplit=1)[0].rstrip(" ").upper() in _DEVICES:
        raise InputError(f"Cannot write the output folder {name!r}: it is the name of a device; give another name.")
    if name != name.rstrip(" .") or any(character in _NO_NAME or ord(character) < 32 for character in name):
        raise InputError(
            f"Cannot write the output folder {name!r}: on Windows a name has none of {' '.join(_NO_NAME)} and does "
            "not end with a blank or a dot; give another name."
        )


def check_inputs(final: Path, inputs: Iterable[str | Path]) -> None:
    """Refuse an input that lies in the folder that is to be written, by whatever way it is named.

    Raises
    ------
    InputError
        If one does.
    """
    folders = [place for place in (final, partial_of(final)) if place.is_dir()]
    for given in inputs:
        path = Path(given)
        if not os.path.lexists(path):
            continue  # a name of ours, or what reading it will say is missing
        above = {path, path.resolve(), Path(os.path.abspath(path))}  # noqa: PTH100 - of a link, where it lies and where it leads
        above |= {parent for one in above for parent in one.parents}
        if any(place.exists() and any(place.samefile(folder) for folder in folders) for place in above):
            raise InputError(
                f"Input {str(path)!r} lies in the output folder {str(final)!r}, which is to be written: give a copy "
                "that lies elsewhere, or another output folder."
            )


def check_is_no_input(final: Path, inputs: Iterable[str | Path]) -> None:
    """Refuse to write over a file that is read, by whatever way it is named.

    Raises
    ------
    InputError
        If the file is one of the inputs, which may be files, folders or patterns.
    """
    if not final.exists():
        return
    for given in inputs:
        path = Path(given)
        there = [path] if path.exists() else [Path(file) for file in glob.glob(str(given), recursive=True)]  # noqa: PTH207 - Path.glob knows no absolute pattern
        if any(one.samefile(final) or (one.is_dir() and one.resolve() in final.resolve().parents) for one in there):
            raise InputError(
                f"Output {str(final)!r} is one of the files that are read (of {str(given)!r}), and these are not "
                "written over: give another name, or another folder."
            )


def check_free(final: Path, *, overwrite: bool) -> None:
    """Refuse a folder that may not be written: one that exists, or that holds what we did not write.

    Raises
    ------
    InputError
        If it may not.
    """
    check_place(final)
    if not final.exists():
        return
    if not overwrite:
        raise InputError(f"Output folder {str(final)!r} exists: give another name, or overwrite it (--overwrite).")
    check_ours(final)


def check_ours(folder: Path) -> None:
    """Refuse to replace a folder with a file that we did not write, or that was changed since.

    Raises
    ------
    InputError
        If there is one.
    """
    for _, reason in _judged(folder):
        if reason:
            raise InputError(f"Output folder {str(folder)!r} {reason}")


def check_links(folder: Path) -> None:
    """Refuse to go on in a folder with links in it: they are never written through.

    Raises
    ------
    InputError
        If there is one.
    """
    for path in _entries(folder):
        if path.is_symlink():
            raise InputError(link_words(folder, path.relative_to(folder).as_posix()))


def link_words(folder: Path, name: str) -> str:
    """Say that a place in a folder is a link."""
    return (
        f"{name!r} in the output folder {str(folder)!r} is a link, which bayes-rs does not write through: remove the "
        "link, or give another name."
    )


def _entries(folder: Path) -> Iterator[Path]:
    """Give every file, folder and link in a folder, what is in a folder before the folder itself: it may be removed."""
    for place in sorted(folder.iterdir()):
        if place.is_dir() and not place.is_symlink():
            yield from _entries(place)
        yield place


def _judged(folder: Path) -> Iterator[tuple[Path, str]]:
    """Give what is in a folder, with the reason why it is not to be removed, or nothing if we wrote it."""
    ledger = read_ledger(folder)
    if ledger is None:
        if any(folder.iterdir()):
            words = f"was not made by bayes-rs (it has no {LEDGER}), so it is not replaced"
            yield folder, f"{words}: give another name, or remove it yourself."
        return
    inner: list[Path] = []
    for place in sorted(folder.iterdir()):
        if place.is_dir() and not place.is_symlink() and _is_inner(place, ledger):  # it has a list of its own
            yield from _judged(place)
            inner.append(place)
    for path in _entries(folder):
        if not any(place in path.parents for place in inner):
            yield path, _reason(path, path.relative_to(folder).as_posix(), ledger)


def _is_inner(place: Path, ledger: Ledger) -> bool:
    """Tell whether a folder is one that the run which wrote the list made in its own: of the key that it noted."""
    own = read_ledger(place)
    return own is not None and own.key is not None and ledger.wrote(place.name, fingerprint_of(own.key.encode()))


def _reason(path: Path, name: str, ledger: Ledger) -> str:
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return f"holds {name!r}, which is a link or a device: move it, or give another name."
    if path.is_dir() or name == LEDGER or path.name.startswith(HALF):
        return ""
    if name not in ledger.files and name not in ledger.earlier:
        return f"holds {name!r}, which bayes-rs did not write: move it, or give another name."
    if not ledger.wrote(name, fingerprint_of_file(path)):
        return f"holds {name!r}, which was changed since bayes-rs wrote it: move it, or give another name."
    return ""


def remove_ours(folder: Path) -> str:
    """Remove a folder file by file, if we wrote all of it; else return what is in the way, and remove nothing."""
    for _, reason in _judged(folder):
        if reason:
            return reason
    ledger = folder / LEDGER  # the last to go: what is left of a removal that was interrupted stays proven
    for path, reason in _judged(folder):
        if reason:
            return reason  # it came just now
        if path.is_dir():
            with suppress(OSError):  # not empty: something came just now
                path.rmdir()
        elif path != ledger:
            path.unlink()
    rest = [path for path in folder.iterdir() if path != ledger]
    if rest:
        return f"holds {rest[0].name!r}, which bayes-rs did not write: move it, or give another name."
    ledger.unlink(missing_ok=True)
    folder.rmdir()
    return ""


def finish_replacing(final: Path) -> None:
    """Put in order what a run left that was killed while its folder took the place of another.

    Raises
    ------
    OSError
        If it cannot be.
    """
    old, part = replaced_of(final), partial_of(final)
    if not old.is_dir() or old.is_symlink():
        return
    if not final.exists():  # killed between the two renamings
        ledger = read_ledger(part) if (part / MARK).is_file() else None
        new = part if ledger is not None and ledger.finished else old
        new.replace(final)
        (final / MARK).unlink(missing_ok=True)
    if old.exists():
        _clear(old, final)


def take_place(part: Path, final: Path) -> None:
    """Give a folder its final name; what has it until then goes, as far as we wrote it.

    Notes
    -----
    Two renamings, and then the removal: a run that is killed meanwhile leaves both folders whole, and
    `finish_replacing` ends what it began. A folder in which something appeared that we did not write is kept whole,
    under another name, and a warning says so.
    """
    check_place(final)
    if not final.exists():
        part.replace(final)
    else:
        old = replaced_of(final)
        final.replace(old)
        try:
            part.replace(final)
        except OSError:
            old.replace(final)
            raise
        _clear(old, final)
    (final / MARK).unlink(missing_ok=True)


def _clear(old: Path, final: Path) -> None:
    reason = remove_ours(old)
    if reason:
        kept = Path(tempfile.mkdtemp(dir=final.parent, prefix=f"{final.name[:_STEM]}.kept-"))
        kept.rmdir()  # it was made for its name: no other system than POSIX puts a folder in the place of an empty one
        old.replace(final.parent / kept.name)
        warnings.warn(
            f"The earlier folder {str(final)!r} is kept as {str(final.parent / kept.name)!r}: it {reason}",
            stacklevel=2,
        )


def cannot_write(what: str, final: Path, error: OSError, advice: str) -> InputError:
    """Say in one line what cannot be written, and why."""
    return InputError(f"Cannot write {what}{str(final)!r}: {error.strerror or error}; {advice}.")


@contextmanager
def no_parents_left(place: Path) -> Iterator[None]:
    """Remove the folders above a place again that the block makes, if it fails and they hold nothing."""
    fresh = [parent for parent in place.parents if not os.path.lexists(parent)]
    try:
        yield
    except BaseException:
        with suppress(OSError):  # the first that holds something, or was never made
            for parent in fresh:
                parent.rmdir()
        raise


def make_folder(place: Path, *, prefix: str) -> Path:
    """Make a fresh folder beside `place`, with the rights of any new folder."""
    place.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(dir=place.parent, prefix=prefix))
    mask = os.umask(0)
    os.umask(mask)
    made.chmod(0o777 & ~mask)
    return place.parent / made.name  # as the user wrote it: from Python 3.12 on, what was made is absolute
