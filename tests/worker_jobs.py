"""Work for tests of other processes, in a module that they load quickly."""

import os
import signal
import time

import numpy as np
from threadpoolctl import threadpool_info

PARTS = list(range(12))


def square(shared, part):
    return shared * part * part


def where(_shared, _part):
    time.sleep(0.05)
    return os.getpid()


def threads(_shared, _part):
    np.ones((2, 2)) @ np.ones((2, 2))
    return max((library["num_threads"] for library in threadpool_info()), default=1)


def die_once(folder, part):
    """Kill the worker, the first time that part 3 or part 7 is tried."""
    return die_at_first(folder, part) if part in (3, 7) else part * part


def die_of_one(_shared, part):
    """Kill the worker whenever the last part is tried."""
    if part == PARTS[-1]:
        os.kill(os.getpid(), signal.SIGKILL)
    return part


def die_five_times(folder, part):
    """Kill the worker at the first try of five of the parts."""
    return die_at_first(folder, part) if part in (1, 3, 5, 7, 9) else part * part


def die_at_first(folder, part):
    try:
        (folder / f"died-{part}").touch(exist_ok=False)
    except FileExistsError:
        return part * part
    os.kill(os.getpid(), signal.SIGKILL)
    return None


def fail(_shared, part):
    if part == 5:
        raise ZeroDivisionError("part five")
    return part


def slow(_shared, part):
    time.sleep(0.3)
    return part


def log_and_sleep(folder, part):
    (folder / str(os.getpid())).touch()
    time.sleep(0.2 if part == 0 else 60.0)
    folder.with_name(f"{folder.name}-ended-{part}").touch()
    return part
