"""Files that are written whole or not at all, and never over something that was there."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_rs.errors import InputError
from bayes_rs.folder_lock import locked

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

RUN_FILE = "run.json"
"""Every output folder of ours holds it: a folder without it is never replaced."""
_STEM = 40
"""Characters of a name in the temporary names beside it, which thus stay short enough for any file system."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a text begins with that a spreadsheet takes for a formula."""


@contextmanager
def output_folder(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a fresh folder to write in, which takes the name `path` once everything in it is written.

    Parameters
    ----------
    path : str or Path
        The folder to make.
    overwrite : bool
        Replace an existing folder, if an earlier run made it.

    Yields
    ------
    folder : Path
        Where to write. If the block fails, what it has written is kept in this folder, and the error says where.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, another run is writing it, or its parent cannot be written.
    """
    final = Path(path)
    with _alone(final, overwrite=overwrite), _fresh_folder(final, overwrite=overwrite) as part:
        yield part


def _alone(final: Path, *, overwrite: bool) -> AbstractContextManager[None]:
    """Keep others from a folder that is to be replaced: a long run may still be filling it."""
    return locked(final) if overwrite and final.is_dir() else nullcontext()


@contextmanager
def _fresh_folder(final: Path, *, overwrite: bool) -> Iterator[Path]:
    try:
        _check_free(final, overwrite=overwrite)
        final.parent.mkdir(parents=True, exist_ok=True)
        made = tempfile.mkdtemp(dir=final.parent, prefix=f"{final.name[:_STEM]}.partial-")
    except OSError as error:
        raise _cannot_write("the output folder ", final, error, "give a folder that can be written") from error
    part = final.parent / Path(made).name  # as the user wrote it: from Python 3.12 on, what was made is absolute
    try:
        yield part
        _check_free(final, overwrite=overwrite)  # another run may have ended meanwhile
        _take_place(part, final)
    except BaseException as error:
        if not part.exists():
            raise
        if any(part.iterdir()):
            error.add_note(f"What was finished is kept in {str(part)!r}.")
        else:
            part.rmdir()
        raise


def _take_place(part: Path, final: Path) -> None:
    try:
        part.chmod(0o777 & ~_umask())
        if not final.exists():
            part.replace(final)
            return
        # two renamings, and then the removal: a run that is killed meanwhile leaves both folders whole
        aside = Path(tempfile.mkdtemp(dir=final.parent, prefix=f"{final.name[:_STEM]}.replaced-"))
        final.replace(aside)
        try:
            part.replace(final)
        except OSError:
            aside.replace(final)
            raise
        shutil.rmtree(aside)
    except OSError as error:
        raise _cannot_write("the output folder ", final, error, "give another name") from error


@contextmanager
def output_file(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a fresh file name to write to, which becomes `path` once it is written.

    Raises
    ------
    InputError
        If the file exists and may not be replaced, or cannot be written.
    """
    final = Path(path)
    try:
        _check_no_file(final, overwrite=overwrite)
        final.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=final.parent, prefix=f".{final.name[:_STEM]}-")
    except OSError as error:
        raise _cannot_write("", final, error, "give a place that can be written") from error
    with folder as name:
        part = Path(name) / final.name
        yield part
        _check_no_file(final, overwrite=overwrite)
        try:
            part.replace(final)
        except OSError as error:
            raise _cannot_write("", final, error, "give a place that can be written") from error


def prepare_resumable_folder(
    path: str | Path, key: str, parts: Mapping[str, str], *, resume: bool, overwrite: bool
) -> Path:
    """Make a folder that is filled part by part, or find the one that an interrupted run left.

    Parameters
    ----------
    path : str or Path
        The folder.
    key : str
        Fingerprint of the run: data, options and version.
    parts : mapping of str to str
        The fingerprints that `key` is made of, by what they are of: they tell what differs from another run.
    resume : bool
        Go on in the folder of an interrupted run with the same key.
    overwrite : bool
        Replace an existing folder, if an earlier run made it.

    Returns
    -------
    folder : Path
        The folder; its `run.json` holds the key and its parts from the beginning.

    Raises
    ------
    InputError
        If the folder exists and is neither to be resumed nor replaced, is of another run, or cannot be written.
    """
    final = Path(path)
    begun = {"key": key, "key_parts": dict(parts), "finished": False}
    try:
        if final.is_dir() and resume and not final.is_symlink():
            found, found_parts = _run_key(final)
            if found == key:
                write_run(final, begun)  # a folder that cannot be written says so now
                return final
            if found is not None and not overwrite:
                raise InputError(
                    f"Output folder {str(final)!r} is of a run that differs in {_differing(found_parts, parts)}, so it "
                    "cannot be resumed: give the same, another name, or overwrite."
                )
        elif final.is_dir() and not overwrite and _run_key(final)[0] == key:
            raise InputError(
                f"Output folder {str(final)!r} exists, from a run of the same data and options: resume to go on with "
                "it, or overwrite to begin anew."
            )
        _check_free(final, overwrite=overwrite)
        final.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=final.parent, prefix=f".{final.name[:_STEM]}-") as name:
            part = (
                Path(name) / "run"
            )  # the folder never exists without its key: it could neither be resumed nor replaced
            part.mkdir()
            write_run(part, begun)
            _take_place(part, final)
    except OSError as error:
        raise _cannot_write("the output folder ", final, error, "give a folder that can be written") from error
    return final


def _run_key(folder: Path) -> tuple[str | None, dict[str, Any]]:
    """Return the key in a folder's run.json and its parts; None and nothing if there is none."""
    try:
        content = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None, {}
    if not isinstance(content, dict):
        return None, {}
    key, parts = content.get("key"), content.get("key_parts")
    return key if isinstance(key, str) else None, parts if isinstance(parts, dict) else {}


def _differing(found: Mapping[str, Any], now: Mapping[str, str]) -> str:
    """Say what differs between two runs, as ``prior and seed``."""
    names = [name.replace("_", " ") for name in now if found and found.get(name) != now[name]]
    return " and ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names) or "data, options or version"


def write_run(folder: Path, content: dict[str, Any]) -> None:
    """Write `run.json`: what was run, with which versions and seed."""
    part = folder / f".{RUN_FILE}.{os.getpid()}"
    try:
        part.write_text(json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")
        part.replace(folder / RUN_FILE)
    finally:
        part.unlink(missing_ok=True)


def write_netcdf(data: xr.Dataset | xr.DataTree, file: Path, **options: Any) -> None:
    """Write a Dataset or a tree of them as NetCDF-4.

    Parameters
    ----------
    data : Dataset or DataTree
        What to write.
    file : Path
        The file, which is replaced.
    **options
        Those of its `to_netcdf`.

    Raises
    ------
    OSError
        If it cannot be written, as on a full disk.

    Notes
    -----
    The file is made in memory first, and so takes its own size in memory: where the HDF5 library itself meets a full
    disk, it cannot close its file and takes the whole process down with it.
    """
    file.write_bytes(data.to_netcdf(engine="h5netcdf", **options))


def write_csv(table: pd.DataFrame, file: Path, **options: Any) -> None:
    """Write a table as CSV in which no text is a formula.

    Parameters
    ----------
    table : DataFrame
        What to write. A text that begins with ``=``, ``+``, ``-``, ``@``, a tab or a carriage return gets a ``'``
        before it, since spreadsheets run such a text; numbers are written as they are.
    file : Path
        The file, which is replaced.
    **options
        Those of `DataFrame.to_csv`.
    """
    texts = [name for name in table.columns if table[name].dtype.kind not in "biufcmM"]
    table.assign(**{name: table[name].map(_plain_cell) for name in texts}).to_csv(file, **options)


def _plain_cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = value.replace("\r", " ")  # which the csv module does not quote: the row would end there
    return f"'{text}" if value.startswith(_FORMULA) else text


def _check_name(final: Path) -> None:
    """Raise what the system says of a name that cannot be; from Python 3.14 on, `exists` says no and nothing more."""
    with suppress(FileNotFoundError, NotADirectoryError):
        final.lstat()


def _check_no_file(final: Path, *, overwrite: bool) -> None:
    _check_name(final)
    if final.is_dir():
        raise InputError(f"Cannot write {str(final)!r}: it is a folder; give the name of a file.")
    if final.exists() and not overwrite:
        raise InputError(f"File {str(final)!r} exists: give another name, or --overwrite to replace it.")


def check_output_folder(path: str | Path, *, overwrite: bool = False) -> None:
    """Refuse an output folder that `output_folder` would refuse, before any work is done for it.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, or another run is writing it.
    """
    final = Path(path)
    try:
        _check_free(final, overwrite=overwrite)
        with _alone(final, overwrite=overwrite):
            pass
    except OSError as error:
        raise _cannot_write("the output folder ", final, error, "give a folder that can be written") from error


def _check_free(final: Path, *, overwrite: bool) -> None:
    _check_name(final)
    if final.is_symlink():
        raise InputError(f"Cannot write the output folder {str(final)!r}: it is a link; give the folder itself.")
    if not final.exists():
        return
    if not final.is_dir():
        raise InputError(
            f"Cannot write the output folder {str(final)!r}: a file of that name exists; give another name."
        )
    if not overwrite:
        raise InputError(f"Output folder {str(final)!r} exists: give another name, or --overwrite to replace it.")
    if any(final.iterdir()) and not (final / RUN_FILE).is_file():
        raise InputError(
            f"Output folder {str(final)!r} was not made by bayes-rs (it has no {RUN_FILE}), so it is not replaced: "
            "give another name, or remove it yourself."
        )


def _cannot_write(what: str, final: Path, error: OSError, advice: str) -> InputError:
    return InputError(f"Cannot write {what}{str(final)!r}: {error.strerror or error}; {advice}.")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
