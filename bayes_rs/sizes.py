"""How large work is before it starts: what needs more memory than there is, or more time than anyone has, is refused.

Sizes are estimated by simple formulas beside the work, and need not be right to more than a factor of two or so.
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from bayes_rs.errors import InputError

if sys.platform != "win32":  # which has no such limits
    import resource

MOST_SECONDS = 30 * 86_400.0
"""Time of one processor that a single piece of work may take: a month. What takes more is a mistake."""
MOMENT = 5.0
"""Seconds up to which a plan computes what it could also only announce."""
_SHARE = 0.8
"""Of the free memory that work may take: estimates are rough, and others need some."""
_GROUPS = {"": ("/sys/fs/cgroup", "memory.max"), "memory": ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")}
"""Where the limits of groups of processes stand, and in which file: of the second version, and of the first."""


def check_size(what: str, n_byte: float, advice: str) -> None:
    """Refuse what does not fit into memory.

    Parameters
    ----------
    what : str
        What would fill the memory, in the plural, with the numbers that make it large.
    n_byte : float
        Bytes that it takes at its largest.
    advice : str
        What to do.

    Raises
    ------
    InputError
        If it is more than most of what is free.

    Examples
    --------
    >>> check_size("A thousand numbers", 8e3, "take fewer.")
    """
    if n_byte < _SMALL:
        return
    free = free_memory()
    if n_byte > _SHARE * free:
        raise InputError(f"{what} would take {in_bytes(n_byte)} of memory, and {in_bytes(free)} are free: {advice}")


def check_work(what: str, seconds: float, advice: str) -> None:
    """Refuse what would take longer than anyone waits.

    Parameters
    ----------
    what : str
        The work, in the plural, with the numbers that make it large.
    seconds : float
        Time of one processor that it takes.
    advice : str
        What to do.

    Raises
    ------
    InputError
        If it is more than a month.

    Examples
    --------
    >>> check_work("A thousand records", 100.0, "take fewer.")
    """
    if not seconds <= MOST_SECONDS:
        raise InputError(
            f"{what} would take about {in_time(seconds)} of one processor, and more than {in_time(MOST_SECONDS)} is "
            f"refused: {advice}"
        )


def free_memory() -> float:
    """Return how many bytes this process may still take: of the machine, of its group and of its own limits."""
    if sys.platform == "win32":
        return _of_windows()
    else:  # noqa: RET505 - for type checkers, which know the system by it
        free = [_of_machine(), *(_of_group(file) for file in _limits())]
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            free.append(max(float(limit) - _own("VmSize"), 0.0))
        return min(free)


def in_bytes(n_byte: float) -> str:
    """Return a number of bytes in words.

    Examples
    --------
    >>> in_bytes(3.2e9), in_bytes(2e22)
    ('3 GiB', '1.86e+13 GiB')
    """
    for name, size in (("GiB", 2.0**30), ("MiB", 2.0**20)):
        if n_byte >= size:
            return f"{n_byte / size:.2g} {name}" if n_byte / size < 100 else f"{n_byte / size:.3g} {name}"
    return f"{n_byte / 1024:.2g} KiB"


def in_time(seconds: float) -> str:
    """Return a time in words.

    Examples
    --------
    >>> in_time(40.0), in_time(7200.0), in_time(5e7)
    ('40 s', '2 hours', '579 days')
    """
    for name, size in (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.2g} s"


_SMALL = 2.0**26
"""Bytes that are not worth a look at what is free."""


def _of_machine() -> float:
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    if sys.platform != "win32":
        with suppress(OSError, ValueError):
            return float(os.sysconf("SC_PAGE_SIZE")) * float(os.sysconf("SC_PHYS_PAGES"))
    return float("inf")


def _of_windows() -> float:
    """Return the bytes of memory that Windows says are free; infinite if it does not say."""
    status = _WindowsMemory(size=ctypes.sizeof(_WindowsMemory))
    kernel: Any = getattr(ctypes, "windll", None)
    told = kernel is not None and kernel.kernel32.GlobalMemoryStatusEx(ctypes.byref(status))
    return float(status.free) if told else float("inf")


class _WindowsMemory(ctypes.Structure):
    """What GlobalMemoryStatusEx fills in (MEMORYSTATUSEX), bytes."""

    _fields_ = [
        ("size", ctypes.c_uint32),
        ("used_percent", ctypes.c_uint32),
        *((name, ctypes.c_uint64) for name in ("all", "free", "page_all", "page_free", "own_all", "own_free", "more")),
    ]


def _limits() -> list[Path]:
    """Return the files with the limits of the groups that this process is in, and of those above them."""
    files = {Path(root, name): None for root, name in _GROUPS.values()}
    with suppress(OSError, ValueError):
        for line in Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            _, kinds, path = line.split(":", 2)
            for kind in kinds.split(","):
                root, name = _GROUPS.get(kind, ("", ""))
                below = Path(path.lstrip("/"))
                files.update({Path(root, above, name): None for above in (below, *below.parents) if root})
    return list(files)


def _of_group(limit: Path) -> float:
    """Return what the group of processes that this one is in may still take; infinite if it has no limit."""
    used = limit.with_name({"memory.max": "memory.current"}.get(limit.name, "memory.usage_in_bytes"))
    with suppress(OSError, ValueError):
        most, now = float(limit.read_text(encoding="ascii")), float(used.read_text(encoding="ascii"))
        cached = 0.0
        for line in limit.with_name("memory.stat").read_text(encoding="ascii").splitlines():
            if line.startswith(("inactive_file ", "total_inactive_file ")):
                cached = float(line.split()[1])  # the kernel gives it back when it is asked for
        return max(most - now + cached, 0.0)
    return float("inf")


def _own(name: str) -> float:
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith(f"{name}:"):
                return 1024.0 * float(line.split()[1])
    return 0.0
