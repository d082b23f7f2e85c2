"""One process that reads NetCDF-4 files, and is killed where the HDF5 library hangs or dies on one."""

from __future__ import annotations

import atexit
import json
import logging
import os
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_rs.errors import InputError
from bayes_rs.readers import netcdf_process

SECONDS = 20.0
BYTES_PER_SECOND = 1e6
"""How long a file may take: far more than a good one does."""
START_SECONDS = 60.0

_SCRIPT = Path(__file__).with_name("netcdf_process.py")
_Key = tuple[str, int, int]
_Answer = tuple[dict[str, Any], bytearray | bytes]
_LOST = ("AttributeError", "TypeError", "AssertionError", "KeyError", "IndexError")
"""Kinds of errors that libraries raise where a file contradicts itself."""
_TRIES = 2  # a process can also die for another reason than the file
_log = logging.getLogger(__name__)


def ask(file: Path, do: str, **what: Any) -> tuple[dict[str, Any], bytearray | bytes]:
    """Have a file looked at, read or closed in the other process, which starts with the first file and ends with this.

    Where no process can be started this one does it, and a warning is logged once.

    Parameters
    ----------
    file : Path
        An HDF5 file.
    do, **what
        As `netcdf_process.answer` says.

    Returns
    -------
    told : dict
        What the answer says.
    content : bytes
        The values that were read.

    Raises
    ------
    InputError
        If there is a fault in it, or the library hangs or dies.
    OSError
        With the words and the number of what the library raised.
    """
    request = {"do": do, **what}
    answer = _guard.ask(file, request)
    return ask_here(file, do, **what) if answer is None else _meaning(file, answer)


def ask_here(file: Path, do: str, **what: Any) -> tuple[dict[str, Any], bytearray | bytes]:
    """Have a file that nobody but us can have written looked at, read or closed by this process; as `ask`."""
    with _guard.here:  # one request at a time, as in the other process: a thread may close what another one reads
        answer = netcdf_process.answer({"file": os.path.abspath(file), "do": do, **what})  # noqa: PTH100 - links stay
    return _meaning(file, answer)


def _meaning(file: Path, answer: _Answer) -> _Answer:
    told, _ = answer
    if "error" in told:
        said = told["error"]
        if told["kind"] in _LOST:
            said = f"the library cannot follow what it says ({said})"
        raise OSError(said) if told["errno"] is None else OSError(told["errno"], said)
    if told.get("fault"):
        raise InputError(f"File {str(file)!r} cannot be read as NetCDF: {told['fault']}")
    return answer


@dataclass
class _Guard:
    """The process, the files on which it hung or died, and what it saw of the last one, which is often opened again.

    `lock` is held by who asks the process, `here` by who reads in this one.
    """

    process: subprocess.Popen[bytes] | None = None
    usable: bool = True
    fatal: dict[_Key, str] = field(default_factory=dict)
    seen: tuple[_Key, _Answer] | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    here: threading.Lock = field(default_factory=threading.Lock)

    def ask(self, file: Path, request: dict[str, Any]) -> _Answer | None:
        """Have a request answered, again by a new process if one dies; None where there is no process."""
        path, stat = os.path.abspath(file), file.stat()  # noqa: PTH100 - the process may stand elsewhere; links stay
        key, seconds = (path, stat.st_size, stat.st_mtime_ns), SECONDS + stat.st_size / BYTES_PER_SECOND
        line = json.dumps({"file": path, "seconds": seconds, **request}).encode() + b"\n"
        with self.lock:
            if request["do"] == "close" and self.process is None:
                return {}, b""
            if request["do"] == "look" and self.seen is not None and self.seen[0] == key:
                return self.seen[1]
            died = False
            for _ in range(0 if key in self.fatal else _TRIES):
                process = self._running()
                if process is None:
                    break
                answer, late = self._exchange(process, line, seconds)
                if answer is not None:
                    if answer[0].get("spoilt"):
                        self.end()
                    if request["do"] == "look" and "groups" in answer[0]:
                        self.seen = key, answer
                    return answer
                died = True
                if late:
                    self.fatal[key] = _fault(f"the HDF5 library has no end with it, after {seconds:.0f} s")
                    break
            if died:
                self.fatal.setdefault(key, _fault("the HDF5 library crashes on it"))
            return ({"fault": self.fatal[key]}, b"") if key in self.fatal else None

    def end(self) -> None:
        """End the process, whatever it does; without one, do nothing."""
        process, self.process = self.process, None
        if process is not None:
            process.kill()
            process.wait()
            _close(process)

    def forget(self) -> None:
        """Leave the process to whom this one was forked from."""
        process, self.process = self.process, None
        self.lock, self.here = threading.Lock(), threading.Lock()  # another thread may have held them
        if process is not None:
            process.returncode = 0  # not ours to wait for
            _close(process)

    def _running(self) -> subprocess.Popen[bytes] | None:
        if self.process is not None and self.process.poll() is not None:
            self.end()
        if self.process is None and self.usable:
            self.process = self._start()
            self.usable = self.process is not None
        return self.process

    def _start(self) -> subprocess.Popen[bytes] | None:
        reason = "no Python to run"
        if sys.executable and not getattr(sys, "frozen", False):
            try:
                self.process = subprocess.Popen(  # noqa: S603 - our own script
                    [sys.executable, "-P", "-W", "ignore", str(_SCRIPT)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,  # Ctrl-C is for who asks; on Windows the next line says so
                    creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
                )
                ready, _ = self._exchange(self.process, b"", START_SECONDS)
            except (OSError, RuntimeError) as error:  # RuntimeError: no thread can be started
                reason = str(error)
            else:
                if ready is not None:
                    return self.process
                reason = "it does not start"
        _log.warning("NetCDF-4 files are read without a process that protects from damaged ones: %s", reason)
        return None

    def _exchange(
        self, process: subprocess.Popen[bytes], request: bytes, seconds: float
    ) -> tuple[_Answer | None, bool]:
        """Send a line and wait for its answer; none, and no process any more, where none comes in time."""
        late, answer = threading.Event(), None

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(seconds, stop)
        timer.daemon = True
        try:
            timer.start()
            with suppress(OSError):
                answer = _exchanged(process, request)
            timer.cancel()
            timer.join()
        except BaseException:  # an interrupt: what is still to be answered must not be taken for the next answer
            timer.cancel()
            self.end()
            raise
        if late.is_set() or answer is None:
            self.end()
        return answer, late.is_set()


def _exchanged(process: subprocess.Popen[bytes], request: bytes) -> _Answer | None:
    """Send a line and read its answer; none, if the process ends before it is whole.

    Without a line, wait until the process is ready, whatever the machine's own set-up of Python prints before.
    """
    if process.stdin is None or process.stdout is None:
        return None
    os.write(process.stdin.fileno(), request)  # past the buffer, which a fork could write a second time
    line = process.stdout.readline()
    while not request and line and not line.endswith(netcdf_process.READY):
        line = process.stdout.readline()
    if not request:
        return ({}, b"") if line else None
    if not line.endswith(b"\n"):
        return None
    told: dict[str, Any] = json.loads(line)
    content = bytearray(told.pop("n_byte"))
    whole = process.stdout.readinto(content) == len(content)  # type: ignore[attr-defined] # a BufferedReader
    return (told, content) if whole else None


def _fault(reason: str) -> str:
    return f"{reason}; check that it is complete and not damaged."


def _close(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


_guard = _Guard()
atexit.register(_guard.end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_guard.forget)
