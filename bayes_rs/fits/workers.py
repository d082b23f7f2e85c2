"""Parts of a long job, done one after the other, by several processes, or on a Dask cluster."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from loky import ProcessPoolExecutor

from bayes_rs._validation import check_count
from bayes_rs.errors import InputError, MissingExtraError, WorkerError
from bayes_rs.processor import end_with, one_thread
from bayes_rs.progress import Tally, tally_in, worker_tally

_Part = TypeVar("_Part")
_Done = TypeVar("_Done")

_AHEAD = 2
"""Parts a worker has waiting: enough to be never idle, few enough that memory does not grow with the job."""
_RESTARTS = 3
"""How often in a row, with no part finished in between, the parts of workers that died are given out again."""
_RESUME = "what was finished is kept, and the same call with resume goes on from there."

_shared: Any = None


def run_serial(
    work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part]
) -> Generator[_Done, None, None]:
    """Do the parts in this process, one after the other."""
    for part in parts:
        yield _limited(work, shared, part)


def run_processes(
    work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part], n_worker: int
) -> Generator[_Done, None, None]:
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
    with worker_tally() as tally:
        yield from _in_pool(work, shared, parts, n_worker, tally)


def _in_pool(
    work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part], n_worker: int, tally: Tally
) -> Generator[_Done, None, None]:
    waiting = list(range(len(parts)))[::-1]
    deaths = 0
    while waiting:
        running: dict[Future[_Done], int] = {}
        # loky: its processes start clean, need no guard in the user's script, and tell when one is killed
        pool = ProcessPoolExecutor(n_worker, initializer=_share, initargs=(shared, os.getpid(), tally.file))
        try:
            while waiting or running:
                while waiting and len(running) < _AHEAD * n_worker:
                    running[pool.submit(_work, work, parts[waiting[-1]])] = waiting[-1]
                    waiting.pop()
                ready = wait(running, tally.seconds, return_when=FIRST_COMPLETED).done
                tally.look()
                for future in ready:
                    done = future.result()  # before it leaves the list of what runs, so that it can be done again
                    del running[future]
                    deaths = 0
                    yield done
        except BrokenProcessPool as error:
            waiting += sorted(running.values(), reverse=True)
            deaths += 1
            if deaths > _RESTARTS:
                raise WorkerError(
                    f"The worker processes died {deaths} times in a row, perhaps for want of memory: use fewer "
                    f"workers; {_RESUME}"
                ) from error
        finally:
            pool.shutdown(kill_workers=bool(running))  # who stops does not wait for what is not wanted any more


def check_workers(workers: int, client: Any = None) -> None:
    """Check who is to do the work, before any is done.

    Raises
    ------
    InputError
        If there are none, or the client cannot be used.
    """
    check_count(workers, what="workers")
    if client is not None and not isinstance(client, str):
        check_client(client)


def done_parts(
    work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part], workers: int, client: Any
) -> Generator[_Done, None, None]:
    """Do the parts, by whom the fit was told: this process, several, or a Dask cluster, itself or by its address."""
    if client is None:
        serial = workers == 1 or len(parts) < 2
        yield from (
            run_serial(work, shared, parts) if serial else run_processes(work, shared, parts, min(workers, len(parts)))
        )
    elif isinstance(client, str):
        with connect(client) as connected:
            yield from run_dask(work, shared, parts, connected)
    else:
        yield from run_dask(work, shared, parts, client)


def check_client(client: Any) -> None:
    """Refuse a Dask client that cannot be used, before any work is done for it.

    Raises
    ------
    InputError
        If it is not a synchronous `dask.distributed.Client`, or that package is not installed.
    """
    try:
        distributed: Any = importlib.import_module("distributed")  # an optional package
    except ImportError as error:
        raise InputError('A Dask client needs the package distributed: run pip install "bayes_rs[dask]".') from error
    if not isinstance(client, distributed.Client) or client.asynchronous:
        raise InputError(f"Invalid client {client!r}: it must be a dask.distributed.Client, not an asynchronous one.")


@contextmanager
def connect(scheduler: str, *, timeout: float = 30.0) -> Iterator[Any]:
    """Connect to the scheduler of a Dask cluster, and let it go at the end.

    Parameters
    ----------
    scheduler : str
        Its address, such as ``tcp://10.0.0.1:8786``.
    timeout : float
        How long to wait for it, s.

    Yields
    ------
    client : dask.distributed.Client
        The connection.

    Raises
    ------
    MissingExtraError
        If the package distributed is not installed.
    InputError
        If there is no scheduler at the address.
    """
    try:
        distributed: Any = importlib.import_module("distributed")  # an optional package
    except ImportError as error:
        raise MissingExtraError(
            'A Dask cluster needs the package distributed: run pip install "bayes_rs[dask]".'
        ) from error
    try:
        client = distributed.Client(scheduler, timeout=timeout)
    except (OSError, ValueError) as error:
        raise InputError(
            f"No Dask scheduler at {scheduler!r} ({error}): give the address that it prints when it starts, such as "
            "tcp://10.0.0.1:8786."
        ) from error
    with client:
        yield client


def run_dask(
    work: Callable[[Any, _Part], _Done], shared: Any, parts: Sequence[_Part], client: Any
) -> Generator[_Done, None, None]:
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
        If `client` cannot be used.
    WorkerError
        If the cluster has no workers, or they die again and again.
    """
    check_client(client)
    distributed: Any = importlib.import_module("distributed")
    waiting = list(range(len(parts)))[::-1]
    deaths = 0
    while waiting:
        running: dict[Any, int] = {}
        queue = distributed.as_completed(loop=client.loop)
        try:
            everywhere = _scatter(client, shared, deaths)
            while waiting or running:
                ahead = _AHEAD * max(sum(client.nthreads().values()), 1)  # a cluster may grow
                while waiting and len(running) < ahead:
                    future = client.submit(_limited, work, everywhere, parts[waiting[-1]], pure=False)
                    running[future] = waiting.pop()
                    queue.add(future)
                future = next(queue)
                done = future.result()
                del running[future]
                future.release()
                deaths = 0
                yield done
        except (distributed.KilledWorker, distributed.CancelledError, _LostError) as error:
            waiting += sorted(running.values(), reverse=True)
            deaths += 1
            # cancelled: no worker is left that holds what was shared; killed: the cluster has tried again by itself
            if deaths > _RESTARTS or isinstance(error, distributed.KilledWorker):
                raise WorkerError(
                    f"The Dask workers died again and again, perhaps for want of memory: {error}; {_RESUME}"
                ) from error
        finally:
            client.cancel(list(running))


class _LostError(Exception):
    """Workers went away while they were sent what all parts need."""


def _scatter(client: Any, shared: Any, deaths: int) -> Any:
    try:
        (everywhere,) = client.scatter([shared], broadcast=True, hash=False)
    except TimeoutError as error:
        if deaths:
            raise WorkerError(
                f"The Dask workers died again and again, perhaps for want of memory, and none is left; {_RESUME}"
            ) from error
        raise WorkerError(
            f"The Dask cluster has no worker ({client!r}): start some, and wait for them with "
            "client.wait_for_workers(1)."
        ) from error
    except (OSError, ValueError) as error:  # a stream that is closed, copies for workers that are gone
        raise _LostError(str(error)) from error
    return everywhere


def _share(shared: Any, parent: int, tally: str | None) -> None:
    global _shared  # noqa: PLW0603 - a process of the pool has nothing else to keep it in
    _shared = shared
    tally_in(tally)
    end_with(parent)


def _work(work: Callable[[Any, _Part], _Done], part: _Part) -> _Done:
    return _limited(work, _shared, part)


def _limited(work: Callable[[Any, _Part], _Done], shared: Any, part: _Part) -> _Done:
    # workers share the cores: more threads in each only get in the others' way; and no number depends on how many
    with one_thread():
        return work(shared, part)
