"""The folder of results that a run fills: made anew, gone on with, or filled beside the one that it replaces."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bayes_rs.errors import InputError
from bayes_rs.folder_lock import locked
from bayes_rs.folder_place import (
    MARK,
    cannot_write,
    check_free,
    check_inputs,
    check_links,
    check_ours,
    check_place,
    finish_replacing,
    make_folder,
    partial_of,
    remove_ours,
)
from bayes_rs.layouts import read_json
from bayes_rs.ledger import KeyLine, Ledger, read_ledger, write_ledger
from bayes_rs.result_folder import RUN_FILE, ResultFolder, going_on

_STEM = 40
"""Characters of a name in the temporary name beside it."""


@contextmanager
def begin_result_folder(
    path: str | Path,
    *,
    key: str,
    key_parts: Mapping[str, Any],
    resume: bool = False,
    overwrite: bool = False,
    inputs: Iterable[str | Path] = (),
) -> Iterator[ResultFolder]:
    """Make a folder that is filled file by file, or find the one that an interrupted run left.

    Parameters
    ----------
    path : str or Path
        The folder.
    key : str
        Fingerprint of the run: data, options and version.
    key_parts : mapping of str to object
        The fingerprints that `key` is made of, by what they are of: they tell what differs from another run.
    resume : bool
        Go on in the folder of a run with the same key, finished or not.
    overwrite : bool
        Replace an existing folder, if we wrote every file in it, and none was changed since. It stays what it is until
        the new one is finished.
    inputs : iterable of str or Path
        Files that the run reads: none may lie in the folder.

    Yields
    ------
    folder : ResultFolder
        The folder, which no other process writes meanwhile; its `run.json` holds the key and its parts from the
        beginning. `ResultFolder.finish` ends the run. If the block fails, what it wrote is kept, and a note of the
        error says where; a new folder without any result is removed.

    Raises
    ------
    InputError
        If the folder exists and is neither to be resumed nor replaced, is of another run, holds a link or what we did
        not write, an input lies in it, another process writes it, or it cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from bayes_rs.result_folder import open_result_folder
    >>> with tempfile.TemporaryDirectory() as place:
    ...     with begin_result_folder(f"{place}/year", key="k", key_parts={"seed": "1"}) as folder:
    ...         folder.write_text("table.csv", "uu")
    ...         folder.finish({"n_record": 1})
    ...     found = open_result_folder(f"{place}/year")
    ...     found.names(), found.finished, found.damage("table.csv")
    (['run.json', 'table.csv'], True, None)
    """
    final = Path(path)
    try:
        check_place(final)
        check_inputs(final, inputs)
    except OSError as error:
        raise _cannot(final, error) from error
    with locked(final):
        try:
            where, resumed = _where(final, key, key_parts, resume=resume, overwrite=overwrite)
            folder = _resumed(where, final, key, key_parts) if resumed else _made(where, final, key, key_parts)
        except OSError as error:
            raise _cannot(final, error) from error
        try:
            yield folder
        except BaseException as error:
            _keep(folder, error, fresh=not resumed)
            raise


def inner_is_done(folder: ResultFolder, name: str, *, key: str) -> bool:
    """Tell whether an earlier run has finished a folder in a folder of results, and nothing of it was changed since."""
    path = folder.path / name
    ledger = read_ledger(path)
    if ledger is None or ledger.damaged or not ledger.finished or ledger.key != key:
        return False
    return not ResultFolder(path, ledger).damaged()


@contextmanager
def begin_inner_folder(path: Path, *, key: str, key_parts: Mapping[str, Any]) -> Iterator[ResultFolder]:
    """Make a folder of results in another one that is open for writing, or go on in that of an interrupted run.

    Parameters
    ----------
    path : Path
        The folder; `ResultFolder.note_inner` has listed it in the one that it lies in, whose lock is its own, too.
    key, key_parts
        As for `begin_result_folder`. A folder with another key is made anew.

    Yields
    ------
    inner : ResultFolder
        The folder.

    Raises
    ------
    InputError
        If the folder holds what we did not write, or cannot be written.
    """
    try:
        if path.exists():
            check_place(path)
            if _key_of(path)[0] == key:
                yield _resumed(path, path, key, key_parts)
                return
            reason = remove_ours(path)
            if reason:
                raise InputError(f"Output folder {str(path)!r} {reason}")
        yield _made(path, path, key, key_parts)
    except OSError as error:
        raise _cannot(path, error) from error


def _cannot(final: Path, error: OSError) -> InputError:
    return cannot_write("the output folder ", final, error, "give a folder that can be written")


def _where(final: Path, key: str, key_parts: Mapping[str, Any], *, resume: bool, overwrite: bool) -> tuple[Path, bool]:
    """Return the folder to write in, and whether a run has begun to fill it."""
    finish_replacing(final)
    part = partial_of(final)
    replacing = (part / MARK).is_file() and not part.is_symlink() and _key_of(part)[0] == key
    found, found_parts = _key_of(final)
    if resume and replacing:
        if final.exists():
            check_ours(final)
        return part, True
    if resume and found == key:
        return final, True
    if resume and found is not None and not overwrite:
        raise InputError(
            f"Output folder {str(final)!r} is of a run that differs in {_differing(found_parts, key_parts)}, so it "
            "cannot be resumed: give the same, another name, or overwrite."
        )
    if final.exists() and not overwrite and (replacing or found == key):
        raise InputError(
            f"Output folder {str(final)!r} exists, from a run of the same data and options: resume to go on with it, "
            "or overwrite to begin anew."
        )
    check_free(final, overwrite=overwrite)
    if not final.exists():
        return final, False
    if part.exists() or part.is_symlink():
        if part.is_symlink() or not (part / MARK).is_file():
            raise InputError(
                f"{str(part)!r} is in the way: the run that is to replace {str(final)!r} writes there until its end; "
                "move it, or give another name."
            )
        reason = remove_ours(part)
        if reason:
            raise InputError(f"Output folder {str(part)!r} {reason}")
    return part, False


def _key_of(folder: Path) -> tuple[str | None, Mapping[str, Any]]:
    """Return the key of the run that wrote a folder, and its parts; None and nothing if they are not known."""
    ledger = read_ledger(folder)
    if ledger is None or ledger.key is not None:
        return (None, {}) if ledger is None else (ledger.key, ledger.key_parts)
    with suppress(InputError):  # the line with the key is damaged: run.json has it, too
        content = ResultFolder(folder, ledger).read(RUN_FILE)
        run = read_json(KeyLine, content, what=RUN_FILE, advice="")
        return run["key"], run["key_parts"]
    return None, {}


def _differing(found: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Say what differs between two runs, as ``prior and seed``."""
    names = [name.replace("_", " ") for name in now if found and found.get(name) != now[name]]
    return " and ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names) or "data, options or version"


def _resumed(where: Path, final: Path, key: str, key_parts: Mapping[str, Any]) -> ResultFolder:
    check_links(where)
    ledger = read_ledger(where) or Ledger()
    ledger.key, ledger.key_parts = key, dict(key_parts)
    folder = ResultFolder(where, ledger, final=final)
    folder.clean()
    write_ledger(where, ledger, finished=False)  # without what the run before could not end
    folder.write_run({})  # a folder that cannot be written says so now
    return folder


def _made(where: Path, final: Path, key: str, key_parts: Mapping[str, Any]) -> ResultFolder:
    """Make the folder: it never exists without its key, and so can be resumed and replaced from the first moment."""
    made = make_folder(where, prefix=f".{where.name[:_STEM]}-")
    try:
        ledger = Ledger(key=key, key_parts=dict(key_parts))
        write_ledger(made, ledger, finished=False)
        ResultFolder(made, ledger, final=final).write_run({})
        if where != final:
            (made / MARK).touch()
        made.replace(where)
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        raise
    return ResultFolder(where, ledger, final=final)


def _keep(folder: ResultFolder, error: BaseException, *, fresh: bool) -> None:
    """Say where the results are that were written until an error; a folder without any goes."""
    if (folder.finished and folder.path == folder.final) or not folder.path.is_dir():
        return
    if fresh and folder.names() == [RUN_FILE] and not remove_ours(folder.path):
        return
    where = repr(str(folder.path))
    if not any(where in note for note in getattr(error, "__notes__", [])):
        error.add_note(f"What was finished is kept in {where}: {going_on(error)}")
