"""Files that are written whole or not at all, and never over something that was there."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_rs.errors import InputError
from bayes_rs.folder_lock import locked
from bayes_rs.folder_place import (
    cannot_write,
    check_free,
    check_inputs,
    check_is_no_input,
    check_place,
    finish_replacing,
    make_folder,
    no_parents_left,
    replaced_of,
    take_place,
)
from bayes_rs.interrupts import check_goes_on
from bayes_rs.result_folder import RUN_FILE, run_bytes, seal_folder

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

_STEM = 40
"""Characters of a name in the temporary names beside it, which thus stay short enough for any file system."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a text begins with that a spreadsheet takes for a formula."""


def as_named(file: Path, named: str | Path) -> Path:
    """Return a file as it is told to who named a folder: from the current directory, if the folder was named so.

    Parameters
    ----------
    file : Path
        The file, a whole path.
    named : str or Path
        What the user named.

    Examples
    --------
    >>> as_named(Path.cwd() / "year" / "report.html", "year").as_posix()
    'year/report.html'
    """
    return file if Path(named).is_absolute() or not file.is_absolute() else Path(os.path.relpath(file))


@contextmanager
def output_folder(path: str | Path, *, overwrite: bool = False) -> Iterator[Path]:
    """Give a fresh folder to write in, which takes the name `path` once everything in it is written.

    Parameters
    ----------
    path : str or Path
        The folder to make.
    overwrite : bool
        Replace an existing folder, if we wrote every file in it, and none was changed since.

    Yields
    ------
    folder : Path
        Where to write. If the block fails, what it has written is kept in this folder, and the error says where; if
        that is nothing, no folder that was made above it stays.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, another run is writing it, or its parent cannot be written.
    """
    final = Path(path)
    try:
        check_place(final)
        alone = _alone(final, overwrite=overwrite)
    except OSError as error:
        raise cannot_write("the output folder ", final, error, "give a folder that can be written") from error
    with alone, no_parents_left(final), _fresh_folder(final, overwrite=overwrite) as part:
        yield part


def _alone(final: Path, *, overwrite: bool) -> AbstractContextManager[None]:
    """Keep others from a folder that is to be replaced: a long run may still be filling it."""
    there = final.is_dir() or replaced_of(final).exists()
    return locked(final) if overwrite and there else nullcontext()


@contextmanager
def _fresh_folder(final: Path, *, overwrite: bool) -> Iterator[Path]:
    try:
        if overwrite:
            finish_replacing(final)
        check_free(final, overwrite=overwrite)
        part = make_folder(final, prefix=f"{final.name[:_STEM]}.partial-")
    except OSError as error:
        raise cannot_write("the output folder ", final, error, "give a folder that can be written") from error
    try:
        yield part
        check_goes_on()
        if not overwrite:
            check_free(final, overwrite=False)  # another run may have ended meanwhile
        try:
            seal_folder(part)
            take_place(part, final)
        except OSError as error:
            raise cannot_write("the output folder ", final, error, "give another name") from error
    except BaseException as error:
        if not part.exists():
            raise
        if any(part.iterdir()):
            error.add_note(f"What was finished is kept in {str(part)!r}.")
        else:
            part.rmdir()
        raise


@contextmanager
def output_file(path: str | Path, *, overwrite: bool = False, inputs: Iterable[str | Path] = ()) -> Iterator[Path]:
    """Give a fresh file name to write to, which becomes `path` once it is written.

    Parameters
    ----------
    path : str or Path
        The file to write.
    overwrite : bool
        Replace an existing file.
    inputs : iterable of str or Path
        Files, folders and patterns that are read: none of their files is replaced.

    Yields
    ------
    file : Path
        Where to write. If the block fails, nothing stays, nor do the folders that were made above it.

    Raises
    ------
    InputError
        If the file exists and may not be replaced, is one of the inputs, or cannot be written.
    """
    final = Path(path)
    with no_parents_left(final), _fresh_file(final, overwrite=overwrite, inputs=inputs) as part:
        yield part


@contextmanager
def _fresh_file(final: Path, *, overwrite: bool, inputs: Iterable[str | Path]) -> Iterator[Path]:
    try:
        _check_no_file(final, overwrite=overwrite)
        check_is_no_input(final, inputs)
        final.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=final.parent, prefix=f".{final.name[:_STEM]}-")
    except OSError as error:
        raise cannot_write("", final, error, "give a place that can be written") from error
    with folder as name:
        part = Path(name) / final.name
        yield part
        check_goes_on()
        _check_no_file(final, overwrite=overwrite)
        try:
            part.replace(final)
        except OSError as error:
            raise cannot_write("", final, error, "give a place that can be written") from error


def write_run(folder: Path, content: dict[str, Any]) -> None:
    """Write `run.json`: what was run, with which versions and seed."""
    part = folder / f".{RUN_FILE}.{os.getpid()}"
    try:
        part.write_bytes(run_bytes(content))
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
    with _without_dask():
        file.write_bytes(data.to_netcdf(engine="h5netcdf", **options))


@contextmanager
def _without_dask() -> Iterator[None]:
    """Let xarray lock a file in memory as it does without a cluster: a Dask client knows no lock of that name."""
    dask = sys.modules.get("dask")
    if dask is None:
        yield
        return
    with dask.config.set(scheduler="synchronous"):
        yield


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
    table.assign(**{name: table[name].map(plain_cell) for name in texts}).to_csv(file, **options)


def plain_cell(value: Any) -> Any:
    """Return a text that no spreadsheet takes for a formula; other values as they are."""
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
    if final.exists() and not final.is_file():  # who may do anything would replace a device of the system by a file
        raise InputError(f"Cannot write {str(final)!r}: it is a device or a pipe; give the name of a file.")
    if final.exists() and not overwrite:
        raise InputError(f"File {str(final)!r} exists: give another name, or overwrite it (--overwrite).")


def check_output_folder(path: str | Path, *, overwrite: bool = False, inputs: Iterable[str | Path] = ()) -> None:
    """Refuse an output folder that `output_folder` would refuse, before any work is done for it.

    Parameters
    ----------
    path : str or Path
        The folder.
    overwrite : bool
        Whether it is to be replaced.
    inputs : iterable of str or Path
        Files that are read: none may lie in it.

    Raises
    ------
    InputError
        If the folder exists and may not be replaced, an input lies in it, or another run is writing it.
    """
    final = Path(path)
    try:
        check_place(final)
        check_inputs(final, inputs)
        check_free(final, overwrite=overwrite)
        with _alone(final, overwrite=overwrite):
            pass
    except OSError as error:
        raise cannot_write("the output folder ", final, error, "give a folder that can be written") from error
