"""What the benchmarks share: seconds of CPU and of the clock, medians of processes, and tables in Markdown."""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd


class Spent(NamedTuple):
    """Seconds that a job took, and what it returned."""

    cpu: float
    clock: float
    result: Any


def spent(job: Callable[[], object]) -> Spent:
    """Return the seconds of a job: CPU with that of its threads and of children that have ended, and of the clock."""
    before, began = _cpu(), time.perf_counter()
    result = job()
    return Spent(_cpu() - before, time.perf_counter() - began, result)


def _cpu() -> float:
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def peak_memory() -> tuple[float, float]:
    """Return the largest memory of this process and of a child that has ended, MB.

    That of this process is the kernel's own count since it began: what `getrusage` says holds its parent's, too.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii")
    own = float(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))
    return own / 1024.0, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0


def run(words: list[str], folder: str | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python with these words, one thread a process; `folder` is where another edition of the package is."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    if folder is not None:
        environment["PYTHONPATH"] = folder
    done = subprocess.run(  # noqa: S603 - our own words
        [sys.executable, *words], capture_output=True, text=True, check=False, env=environment
    )
    if done.returncode:
        raise RuntimeError(f"{words} failed:\n{done.stdout}{done.stderr}")
    return done


def told_by(words: list[str], folder: str | None = None) -> dict[str, Any]:
    """Return what a Python process says in the last line that it prints, as JSON."""
    found: dict[str, Any] = json.loads(run(words, folder).stdout.strip().splitlines()[-1])
    return found


def medians(words: list[str], runs: int, folder: str | None = None) -> dict[str, float]:
    """Return the median of each number that a Python process tells, over several processes."""
    found = [told_by(words, folder) for _ in range(runs)]
    return {name: statistics.median(one[name] for one in found) for name in found[0]}


def table(frame: pd.DataFrame) -> str:
    """Lay out a table in Markdown."""
    rows = [list(frame.columns), ["---"] * len(frame.columns), *frame.astype(str).to_numpy().tolist()]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows) + "\n"


def load() -> str:
    """Say how busy the machine is."""
    return f"load {os.getloadavg()[0]:.1f}"
