"""One process that reads NetCDF-4 files first, and is killed where the HDF5 library hangs or dies on one."""

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

from bayes_rs.readers import netcdf_walk

SECONDS = 20.0
BYTES_PER_SECOND = 1e6
"""How long a file may take: far more than a good one does."""
START_SECONDS = 60.0

_SCRIPT = Path(__file__).with_name("netcdf_walk.py")
_Key = tuple[str, int, int]
_TRIES = 2  # a process can also die for another reason than the file
_log = logging.getLogger(__name__)


def find_fault(file: Path) -> str:
    """Have a file walked over in the other process, which starts with the first file and ends with this process.

    Where no process can be started this one walks, and a warning is logged once.

    Parameters
    ----------
    file : Path
        An HDF5 file.

    Returns
    -------
    fault : str
        What is wrong with it, nothing for a good file.

    Raises
    ------
    OSError
        With the words and the number of what a library raised.
    """
    fault = _guard.ask(file)
    return netcdf_walk.find_fault(str(file)) if fault is None else fault


@dataclass
class _Guard:
    """The process, the files on which it hung or died, and the last one that was good: it is often opened again."""

    process: subprocess.Popen[bytes] | None = None
    usable: bool = True
    fatal: dict[_Key, str] = field(default_factory=dict)
    good: _Key | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def ask(self, file: Path) -> str | None:
        """Have a file walked over; again by a new process if one dies."""
        path, stat = os.path.abspath(file), file.stat()  # noqa: PTH100 - the process may stand elsewhere; links stay
        key, seconds = (path, stat.st_size, stat.st_mtime_ns), SECONDS + stat.st_size / BYTES_PER_SECOND
        request = json.dumps({"file": path, "seconds": seconds}).encode() + b"\n"
        with self.lock:
            if key == self.good:
                return ""
            if key in self.fatal:
                return self.fatal[key]
            died = False
            for _ in range(_TRIES):
                process = self._running()
                if process is None:
                    break
                answer, late = self._exchange(process, request, seconds)
                if answer:
                    fault = self._meaning(answer)
                    self.good = None if fault else key
                    return fault
                died = True
                if late:
                    self.fatal[key] = _fault(f"the HDF5 library has no end with it, after {seconds:.0f} s")
                    return self.fatal[key]
            if died:
                self.fatal[key] = _fault("the HDF5 library crashes on it")
            return self.fatal.get(key)

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
        self.lock = threading.Lock()  # another thread may have held it
        if process is not None:
            process.returncode = 0  # not ours to wait for
            _close(process)

    def _meaning(self, answer: bytes) -> str:
        found: dict[str, Any] = json.loads(answer)
        if "error" in found:
            if found["spoilt"]:
                self.end()
            error = OSError(found["error"])
            error.errno = found["errno"]
            raise error
        fault: str = found.get("fault", "")
        return fault

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
                    bufsize=0,
                    start_new_session=True,  # Ctrl-C is for who asks
                )
                line, _ = self._exchange(self.process, b"", START_SECONDS)
            except (OSError, RuntimeError) as error:  # RuntimeError: no thread can be started
                reason = str(error)
            else:
                if line == netcdf_walk.READY:
                    return self.process
                reason = "it does not start"
        _log.warning("NetCDF-4 files are read without a process that protects from damaged ones: %s", reason)
        return None

    def _exchange(self, process: subprocess.Popen[bytes], request: bytes, seconds: float) -> tuple[bytes, bool]:
        """Send a line and wait for one; nothing, and no process any more, where none comes in time."""
        late = threading.Event()

        def stop() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(seconds, stop)
        timer.daemon = True
        line = b""
        try:
            timer.start()
            if process.stdin is None or process.stdout is None:
                return b"", False
            with suppress(OSError):
                if request:
                    process.stdin.write(request)
                line = process.stdout.readline()
            timer.cancel()
            timer.join()
        except BaseException:  # an interrupt: what is still to be answered must not be taken for the next answer
            timer.cancel()
            self.end()
            raise
        complete = line.endswith(b"\n")
        if late.is_set() or not complete:
            self.end()
        return (line if complete else b""), late.is_set()


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
