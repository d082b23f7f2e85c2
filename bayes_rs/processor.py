"""The kind of processor that numbers come from: their last bits depend on it, and on nothing else of a machine."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController, threadpool_info

if sys.platform == "win32":
    import _winapi

_SYNCHRONIZE = 0x00100000
"""Right to wait for a process of Windows."""
_log = logging.getLogger(__name__)


@cache
def processor_kind() -> str:
    """Return what NumPy and BLAS found of this processor, and calculate by, as ``X86_V2 X86_V3, openblas Haswell``."""
    import scipy.linalg  # noqa: F401, PLC0415 - it brings a BLAS of its own

    config: Any = np.show_config(mode="dicts") or {}
    simd = config.get("SIMD Extensions", {})
    found = [str(name) for where in ("baseline", "found") for name in simd.get(where, [])]
    blas = {
        f"{library['internal_api']} {library['architecture']}"
        for library in threadpool_info()
        if library["user_api"] == "blas" and library.get("architecture")
    }
    return ", ".join([" ".join(found) or "unknown", *sorted(blas)])


def note_processor(kinds: list[str], kind: str) -> bool:
    """Add a kind of processor to those that the numbers of a fit come from; warn if there is another; say if it is new.

    Examples
    --------
    >>> kinds = ["X86_V3"]
    >>> note_processor(kinds, "X86_V3"), kinds
    (False, ['X86_V3'])
    """
    if kind in kinds:
        return False
    if kinds:
        _log.warning(
            "Numbers of this fit come from processors of different kinds (%s; %s): they are the same up to their last "
            "digits, medians up to 3e-6 of their value.",
            *("; ".join(kinds), kind),
        )
    kinds.append(kind)
    return True


def end_with(parent: int) -> None:
    """End this process when the one that started it is gone: killed, it could not say goodbye."""

    def watch() -> None:
        if sys.platform == "win32":  # where the number of the parent stays when it is gone
            with suppress(OSError):  # it is gone already
                handle = _winapi.OpenProcess(_SYNCHRONIZE, False, parent)
                _winapi.WaitForSingleObject(handle, _winapi.INFINITE)
        else:
            while os.getppid() == parent:
                time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def one_thread() -> Iterator[None]:
    """Have BLAS calculate with one thread: sums are then in one order, whatever the number of cores."""
    with _libraries().limit(limits=1):
        yield


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries whose threads are limited, found once: to look through all that are loaded takes 1 ms."""
    import scipy.linalg  # noqa: F401, PLC0415 - it brings a BLAS of its own, and only one that is there is limited

    return ThreadpoolController()
