"""Parts of a long job, done one after the other, by several processes, or on a Dask cluster."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from loky import ProcessPoolExecutor
from threadpoolctl import threadpool_limits

from bayes_rs.errors import InputError, WorkerError

_Part = TypeVar("_Part")
_Done = TypeVar("_Done")

_AHEAD = 2
"""Parts a worker has waiting: enough to be never idle, few enough that memory does not grow with the job."""
_RESTARTS = 3
"""How often processes that were killed are started anew."""

_shared: Any = None


def run_serial(work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part]) -> Iterator[_Done]:
    """Do the parts in this process, one after the other."""
    for part in parts:
        yield work(shared, part)


def run_processes(
    work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part], n_worker: int
) -> Iterator[_Done]:
    """Do the parts in several processes; results come in the order in which they are done.

    Parameters
    ----------
    work : callable
        Takes `shared` and one part; defined in a module.
    shared : object
        What all parts need; sent to each process once.
    parts : sequence
        The parts.
    n_worker : int
        Number of processes, each with one thread.

    Yields
    ------
    done
        The results.

    Raises
    ------
    WorkerError
        If processes are killed again and again.
    """
    waiting = list(range(len(parts)))[::-1]
    for attempt in range(_RESTARTS + 1):
        running: dict[Future[_Done], int] = {}
        # loky: its processes start clean, need no guard in the user's script, and tell when one is killed
        with ProcessPoolExecutor(n_worker, initializer=_share, initargs=(shared,)) as pool:
            try:
                while waiting or running:
                    while waiting and len(running) < _AHEAD * n_worker:
                        running[pool.submit(_work, work, parts[waiting[-1]])] = waiting[-1]
                        waiting.pop()
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        done = future.result()  # before it leaves the list of what runs, so that it can be done again
                        del running[future]
                        yield done
            except BrokenProcessPool as error:
                waiting += sorted(running.values(), reverse=True)
                if attempt == _RESTARTS:
                    raise WorkerError(
                        f"The worker processes died {attempt + 1} times, perhaps for want of memory: use fewer "
                        "workers; what was finished is kept, and the same command with resume goes on from there."
                    ) from error
            else:
                return
            finally:
                for future in running:
                    future.cancel()


def run_dask(work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part], client: Any) -> Iterator[_Done]:
    """Do the parts on a Dask cluster; results come in the order in which they are done.

    Parameters
    ----------
    work : callable
        Takes `shared` and one part; defined in a module that the workers can import.
    shared : object
        What all parts need; sent to each worker once.
    parts : sequence
        The parts.
    client : dask.distributed.Client
        The cluster. It does the work of a lost worker again on another.

    Yields
    ------
    done
        The results.

    Raises
    ------
    InputError
        If `client` is no Dask client.
    """
    try:
        distributed: Any = importlib.import_module("distributed")  # an optional package
    except ImportError as error:
        raise InputError('A Dask client needs the package distributed: run pip install "bayes_rs[dask]".') from error
    if not isinstance(client, distributed.Client):
        raise InputError(f"Invalid client {client!r}: it must be a dask.distributed.Client.")
    (everywhere,) = client.scatter([shared], broadcast=True, hash=False)
    waiting = iter(parts)
    ahead = _AHEAD * max(sum(client.nthreads().values()), 1)
    first = [
        client.submit(_limited, work, everywhere, part, pure=False)
        for part, _ in zip(waiting, range(ahead), strict=False)
    ]
    queue = distributed.as_completed(first)
    for future in queue:
        yield future.result()
        future.release()
        for part in waiting:
            queue.add(client.submit(_limited, work, everywhere, part, pure=False))
            break


def _share(shared: Any) -> None:
    global _shared  # noqa: PLW0603 - a process of the pool has nothing else to keep it in
    _shared = shared


def _work(work: Callable[[Any, _Part], _Done], part: _Part) -> _Done:
    return _limited(work, _shared, part)


def _limited(work: Callable[[Any, _Part], _Done], shared: Any, part: _Part) -> _Done:
    with threadpool_limits(1):  # workers share the cores: more threads in each only get in the others' way
        return work(shared, part)
