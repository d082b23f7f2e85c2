"""Random cases for as long as told: python tests/stress/long_run.py --seconds 3600 [--seed 0] [--workers 2].

Prints how many cases of each check were run, and every failure with its name and seed, which `cases.run` repeats.
Exit code 1 if there was one.
"""

import argparse
import multiprocessing
import sys
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1])]

from stress.cases import CHECKS, run  # noqa: E402 - after the path


def work(first: int, step: int, seconds: float, results: "multiprocessing.Queue") -> None:
    """Run cases first, first + step, … of all checks in turn, each check for about the same time."""
    warnings.simplefilter("error")
    spent = dict.fromkeys(CHECKS, 0.0)
    seed = dict.fromkeys(CHECKS, first)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        name = min(spent, key=spent.__getitem__)
        start = time.monotonic()
        failure = ""
        try:
            run(name, seed[name])
        except Exception:  # noqa: BLE001 - whatever it is, it is a finding
            failure = traceback.format_exc()
        spent[name] += time.monotonic() - start
        results.put((name, seed[name], failure))
        seed[name] += step
    results.put(None)


def main() -> None:
    """Run and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1000, help="first seed; the tests use those from 0")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    jobs = [
        context.Process(target=work, args=(options.seed + index, options.workers, options.seconds, results))
        for index in range(options.workers)
    ]
    for job in jobs:
        job.start()
    count, failures, running = Counter(), [], len(jobs)
    while running:
        item = results.get()
        if item is None:
            running -= 1
            continue
        name, seed, failure = item
        count[name] += 1
        if failure:
            failures.append((name, seed, failure))
            print(f"FAILED {name} seed {seed}\n{failure}", flush=True)
    for name in CHECKS:
        print(f"{name:<40}{count[name]:>9} cases, {sum(one == name for one, *_ in failures)} failed")
    print(f"{sum(count.values())} cases, {len(failures)} failed, {options.seconds:g} s on {options.workers} workers")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
