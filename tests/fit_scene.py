"""A small fit for tests, and for the processes that tests start, interrupt and kill."""

import os
import signal
import sys
from pathlib import Path

import numpy as np
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import NotPositiveDefiniteError, fit, load_scan
from bayes_rs.fits import parts, plan
from bayes_rs.priors import WeakPrior

SCAN = load_scan("6-beam")
NOISE = plain_noise(SCAN)
N_RECORD = 23
PART = 5
EMPTY_PART = slice(10, 15)
FIT_PART = parts.fit_part
OPTIONS = {"noise": NOISE, "seed": 3, "target_ess": 200, "sampler": "auto"}


def fit_to(records, scan, folder, **options):
    """Fit into a folder, as a long fit does: without draws."""
    return fit(records, scan, output=folder, **{"draws": "none", **options})


def make_records(n_record=N_RECORD):
    """Records of the weak prior; where there are 23, a part without any that can be fitted, and others that cannot."""
    stress = WeakPrior(log_sd_uu=0.5).draw(n_record, seed=11)
    records = records_of(draw_variances(stress, SCAN, NOISE, np.random.default_rng(12)), SCAN)
    if n_record == N_RECORD:
        records["flag"].values[EMPTY_PART] = 1
        records["wind_speed"].values[2] = np.nan
        records["flag"].values[4, [0, 3]] = 1
        records["variance"].values[8] = 0.0
        records["variance"].values[20, 4] *= 1e-3  # uneven weights: emcee takes over, and is soon done
    return records


def die_at_write(number, *, half_written):
    """Kill this process when it writes its part's file of that number, before it or in the middle of it."""
    write = Path.write_bytes
    count = iter(range(1_000_000))

    def writing(path, content):
        if path.name.startswith(".half.part-") and next(count) == number:
            write(path, content[: len(content) // 2 if half_written else 0])
            os.kill(os.getpid(), signal.SIGKILL)
        return write(path, content)

    Path.write_bytes = writing


def fail_at_part_three(shared, part):
    if part.index == 3:
        raise ZeroDivisionError("part three")
    return FIT_PART(shared, part)


def fit_part_and_die_once(shared, part):
    """Kill the worker at the first try of part 2, which the file of that name remembers."""
    if part.index == 2:
        try:
            Path(os.environ.get("BAYES_RS_TEST_DIED", os.devnull)).touch(exist_ok=False)
        except FileExistsError:  # also on a Dask cluster, where the worker that takes over has a fresh environment
            pass
        else:
            os.kill(os.getpid(), signal.SIGKILL)
    return FIT_PART(shared, part)


def singular(records, numbers):
    """Return a `fit_batch` that fails for batches with one of these records."""
    keys = records["time"].values[numbers].astype(np.int64)
    fit_batch = parts.fit_batch

    def fitting(batch, *arguments, **options):
        if np.isin(batch.key, keys).any():
            raise NotPositiveDefiniteError("singular noise", smallest_eigenvalue=0.0)
        return fit_batch(batch, *arguments, **options)

    return fitting


def set_variable(name, value):
    os.environ[name] = value


if __name__ == "__main__":
    plan.PART_RECORDS = PART
    folder, workers, number, draws = sys.argv[1:5]
    die_at_write(int(number), half_written=True)
    fit_to(make_records(), SCAN, folder, workers=int(workers), draws=draws, **OPTIONS)
