"""A folder of results: every file whole or not there, and known by its fingerprint when it is read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bayes_rs.errors import InputError, LostResultsError
from bayes_rs.folder_place import MARK, cannot_write, link_words, take_place
from bayes_rs.interrupts import check_goes_on
from bayes_rs.layouts import read_json
from bayes_rs.ledger import (
    HALF,
    LEDGER,
    Ledger,
    append_to_ledger,
    fingerprint_of,
    fingerprint_of_file,
    read_ledger,
    write_ledger,
)

RUN_FILE = "run.json"
"""What was run, with which versions and seed: it is in every folder of results."""
_LISTED = 5
"""Damaged files that a message names one by one."""


def going_on(error: BaseException) -> str:
    """Say how a run goes on that an error ended: what is wrong with input comes again until it is corrected."""
    if isinstance(error, InputError):
        return (
            "once the input is corrected, the same call with resume goes on from there; a call with other options "
            "needs overwrite, or another name."
        )
    return "the same call with resume goes on from there."


class ResultFolder:
    """A folder of results that is open: for reading, by `open_result_folder`, or for writing, by `begin_result_folder`.

    Parameters
    ----------
    path : Path
        The folder.
    ledger : Ledger
        Its list of files.
    final : Path, optional
        The name that it takes when it is finished; it may be written only if that is given.

    Attributes
    ----------
    path : Path
        Where the files are now.
    final : Path or None
        The name that it takes when it is finished.
    """

    def __init__(self, path: Path, ledger: Ledger, *, final: Path | None = None) -> None:
        self.path = path
        self.final = final
        self._ledger = ledger
        self._place = path.stat()

    @property
    def finished(self) -> bool:
        """Whether the run that wrote it came to its end."""
        return self._ledger.finished

    @property
    def key(self) -> str | None:
        """The fingerprint of the run: data, options and version."""
        return self._ledger.key

    @property
    def key_parts(self) -> dict[str, Any]:
        """The fingerprints that the key is made of, by what they are of."""
        return self._ledger.key_parts

    def names(self, prefix: str = "") -> list[str]:
        """Return the files that belong to the results and begin so, sorted: paths in the folder, with slashes."""
        return sorted(name for name in self._ledger.files.keys() - self._ledger.beside if name.startswith(prefix))

    def damage(self, name: str) -> str | None:
        """Say in a few words what is wrong with a file; None if it is there, with the bytes that were written."""
        return self._damage(name, None)

    def damaged(self) -> dict[str, str]:
        """Return what is wrong with the files that belong to the results, by their names; nothing if all are whole."""
        found = {name: self.damage(name) for name in self.names()}
        return {name: reason for name, reason in found.items() if reason is not None}

    def _damage(self, name: str, content: bytes | None) -> str | None:
        listed = self._ledger.files.get(name)
        if listed is None:
            return f"is not in {LEDGER}"
        file = self.path / name
        try:
            n_byte = file.stat().st_size if content is None else len(content)
            if not file.is_file():
                return "is not a file"
            if n_byte != listed.n_byte:
                return f"has {n_byte} bytes, and {listed.n_byte} were written"
            found = fingerprint_of_file(file) if content is None else fingerprint_of(content)
        except (FileNotFoundError, NotADirectoryError):
            return "is missing"
        except OSError as error:
            return f"cannot be read ({error.strerror or error})"
        return None if found == listed else "was changed since it was written"

    def read(self, name: str) -> bytes:
        """Return the bytes of a file, which are those that were written.

        Raises
        ------
        InputError
            If they are not.
        """
        try:
            content = (self.path / name).read_bytes() if name in self._ledger.files else None
        except OSError:
            content = None  # `_damage` says why
        reason = self._damage(name, content)
        if reason is not None or content is None:
            raise self._unusable(name, reason or "cannot be read")
        return content

    def checked(self, name: str) -> Path:
        """Return the path of a file that holds what was written.

        Raises
        ------
        InputError
            If it does not.
        """
        reason = self.damage(name)
        if reason is not None:
            raise self._unusable(name, reason)
        return self.path / name

    def run(self) -> dict[str, Any]:
        """Return what `run.json` says.

        Raises
        ------
        InputError
            If it is not as it was written, or no JSON.
        """
        what = f"File {str(self.path / RUN_FILE)!r}"
        found: dict[str, Any] = read_json(dict[str, Any], self.read(RUN_FILE), what=what, advice="fit anew")
        return found

    def _unusable(self, name: str, reason: str) -> InputError:
        if self.final is None and not self.path.is_dir():
            return InputError(
                f"Folder {str(self.path)!r} was moved or removed after it was opened: open it where it is now."
            )
        return InputError(f"File {str(self.path / name)!r} {reason}: resume the fit to make it again.")

    def write(self, name: str, writer: Callable[[Path], object]) -> None:
        """Write a file that appears whole or not at all.

        Parameters
        ----------
        name : str
            Its path in the folder, with slashes.
        writer : callable
            Writes to the path that it is given: a name beside the file, with the same ending.

        Raises
        ------
        InputError
            If a part of the path is a link.
        LostResultsError
            If the folder was moved or removed meanwhile.
        OSError
            If it cannot be written, as on a full disk.

        Notes
        -----
        The bytes are on the disk, then the line in the list, then the file has its name: a run that is killed leaves
        a file that counts for nothing or one that is listed, and nothing between.
        """
        file = self._place_for(name)
        file.parent.mkdir(parents=True, exist_ok=True)
        half = file.with_name(f"{HALF}{file.name}")
        half.unlink(missing_ok=True)  # whatever it is: no link is written through
        listed = False
        try:
            writer(half)
            check_goes_on()
            found = fingerprint_of_file(half, to_disk=True)
            append_to_ledger(self.path, name, found)
            listed = True
            self._ledger.put(name, found)
            half.replace(file)
        except BaseException:
            if not listed:  # what is listed takes its name when the run is resumed
                half.unlink(missing_ok=True)
            raise

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write a file of these bytes, as `write` does."""
        self.write(name, lambda file: file.write_bytes(content))

    def write_text(self, name: str, text: str) -> None:
        """Write a text as UTF-8, as `write` does."""
        self.write_bytes(name, text.encode("utf-8"))

    def note_inner(self, name: str, key: str) -> None:
        """List a folder in this one that has a list of its own, by its key, before it is made.

        Raises
        ------
        InputError
            If there is a link of that name.
        """
        self._place_for(name)
        noted = fingerprint_of(key.encode())
        append_to_ledger(self.path, name, noted, beside=True)
        self._ledger.put(name, noted, beside=True)

    def remove(self, name: str) -> None:
        """Remove a file of the folder, and the folders that are empty then; nothing if it is not listed.

        Raises
        ------
        InputError
            If a part of the path is a link.
        """
        if name not in self._ledger.files:
            return
        file = self._place_for(name)
        append_to_ledger(self.path, name, None)
        self._ledger.put(name, None)
        file.unlink(missing_ok=True)
        above = file.parent
        while above != self.path and above.is_dir() and not any(above.iterdir()):
            above.rmdir()
            above = above.parent

    def clean(self) -> None:
        """Remove what an interrupted run had half written; what it had written whole and listed takes its name."""
        for half in sorted(self.path.rglob(f"{HALF}*")):
            name = half.with_name(half.name.removeprefix(HALF)).relative_to(self.path).as_posix()
            if half == self.path / MARK and self.path != self.final:
                continue
            self._place_for(name)
            if (
                half.is_file()
                and self.damage(name) is not None
                and fingerprint_of_file(half) == self._ledger.files.get(name)
            ):
                half.replace(self.path / name)
            else:
                half.unlink()
        for name, earlier in self._ledger.earlier.items():
            file = self._place_for(name)
            if file.is_file() and self.damage(name) is not None and fingerprint_of_file(file) in earlier:
                file.unlink()  # its successor was listed and never came

    def check_whole(self) -> None:
        """Check that all files are there, with the bytes that this run and those before it wrote.

        Raises
        ------
        LostResultsError
            If one is not, or the folder was moved or removed.
        """
        final = self._writable()
        self._check_place()
        lost = self.damaged()
        if lost:
            raise LostResultsError(_lost_words(final, lost), damage=lost)

    def finish(self, content: Mapping[str, Any]) -> None:
        """End the run: all that it wrote is there, `run.json` says so, and the folder takes its name.

        Parameters
        ----------
        content : dict
            What `run.json` is to say. Its key, the parts of that and ``finished`` are added.

        Raises
        ------
        LostResultsError
            If a file is gone, or is not what was written; `run.json` then says that the run is not finished.
        InputError
            If the folder that is to be replaced has become a link.

        Warns
        -----
        UserWarning
            If something appeared in the folder that was to be replaced: it is kept whole, under another name.
        """
        final = self._writable()
        self.check_whole()
        self.clean()
        self.write_run({**content, "finished": True})
        on_disk = read_ledger(self.path)
        if on_disk is not None:
            for name in on_disk.beside - self._ledger.files.keys():  # a report of what was there so far
                self._ledger.put(name, on_disk.files[name], beside=True)
        write_ledger(self.path, self._ledger, finished=True)
        if self.path != final:
            try:
                take_place(self.path, final)
            except OSError as error:
                raise cannot_write("the output folder ", final, error, "give another name") from error
            self.path = final

    def write_run(self, content: Mapping[str, Any]) -> None:
        """Write `run.json`, with the key of the run and its parts; until `finish`, it says that it is not finished."""
        run = {"finished": False, **content, "key": self.key, "key_parts": self.key_parts}
        self.write_bytes(RUN_FILE, run_bytes(run))

    def _writable(self) -> Path:
        if self.final is None:
            raise RuntimeError(f"The folder {str(self.path)!r} is open for reading only.")
        return self.final

    def _check_place(self) -> None:
        try:
            there = os.path.samestat(self.path.stat(), self._place)
        except (FileNotFoundError, NotADirectoryError):
            there = False
        if not there:
            raise LostResultsError(
                f"Output folder {str(self.path)!r} was moved or removed while a run was writing it: move it back and "
                "resume, or begin anew.",
                damage=dict.fromkeys(self.names(), "is missing"),
            )

    def _place_for(self, name: str) -> Path:
        """Return the path of a file that may be written."""
        self._writable()
        self._check_place()
        file = self.path
        for part in name.split("/"):
            file /= part
            if file.is_symlink():
                raise InputError(link_words(self.path, file.relative_to(self.path).as_posix()))
        return file


def _lost_words(final: Path, lost: Mapping[str, str]) -> str:
    listed = ", ".join(f"{name} {reason}" for name, reason in list(lost.items())[:_LISTED])
    more = f" and {len(lost) - _LISTED} more" if len(lost) > _LISTED else ""
    files = "1 file" if len(lost) == 1 else f"{len(lost)} files"
    return (
        f"Output folder {str(final)!r} is not finished: {files} that this run wrote cannot be used ({listed}{more}); "
        "resume to make them again."
    )


def run_bytes(content: Mapping[str, Any]) -> bytes:
    """Return what is written to `run.json`: JSON that any reader takes."""
    return (json.dumps(content, indent=2, sort_keys=True, allow_nan=False) + "\n").encode("utf-8")


def open_result_folder(path: str | Path) -> ResultFolder:
    """Open a folder of results for reading; nothing is written, and a run may still be filling it.

    Parameters
    ----------
    path : str or Path
        The folder.

    Returns
    -------
    folder : ResultFolder
        Its files; `ResultFolder.finished` tells whether its run came to an end.

    Raises
    ------
    InputError
        If there is no such folder, it is not of ours, or its list of files was changed.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"No folder {str(folder)!r}: give the output folder of a bayes-rs run.")
    ledger = read_ledger(folder)
    if ledger is None:
        raise InputError(
            f"No results in {str(folder)!r}: it has no {LEDGER}; give the output folder of a bayes-rs run."
        )
    if ledger.damaged:
        raise InputError(
            f"File {str(folder / LEDGER)!r} was changed since it was written: resume the fit to make it again."
        )
    return ResultFolder(folder, ledger)


def seal_folder(folder: Path, *, key: str | None = None) -> None:
    """Write the list of all files in a folder that we have just filled.

    Raises
    ------
    OSError
        If a file cannot be read, or the list not written.
    """
    ledger = Ledger(key=key)
    for file in sorted(folder.rglob("*")):
        if file.is_file() and file != folder / LEDGER:
            ledger.put(file.relative_to(folder).as_posix(), fingerprint_of_file(file, to_disk=True))
    write_ledger(folder, ledger, finished=True)


def list_beside(file: Path) -> None:
    """List a file that we wrote into a folder of results afterwards, as a report; nothing if it is in none.

    Raises
    ------
    OSError
        If a list cannot be written.
    """
    changed = [file.absolute()]
    for folder in changed[0].parents:
        ledger = read_ledger(folder)
        if ledger is None or ledger.damaged:
            continue
        for path in changed:
            name, found = path.relative_to(folder).as_posix(), fingerprint_of_file(path, to_disk=True)
            beside = name not in ledger.files or name in ledger.beside
            ledger.put(name, found, beside=beside)
            if not ledger.finished:  # a run may be adding lines of its own
                append_to_ledger(folder, name, found, beside=beside)
        if ledger.finished:
            write_ledger(folder, ledger, finished=True)
        changed.append(folder / LEDGER)
