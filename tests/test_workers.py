"""Work done by several processes and on a Dask cluster: the same results, and nothing lost with a worker."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import dask
import distributed
import psutil  # comes with distributed
import pytest
from worker_jobs import (
    PARTS,
    die_five_times,
    die_of_one,
    die_once,
    fail,
    log_and_sleep,
    slow,
    square,
    threads,
    where,
)

from bayes_rs import InputError, WorkerError
from bayes_rs.fits.workers import run_dask, run_processes, run_serial

pytestmark = pytest.mark.slow


def alive(process):
    """Tell whether a process runs; one that ended and waits to be read does not."""
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def wait_for(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return found


class TestSerial:
    def test_results_come_in_order(self):
        assert list(run_serial(square, 2, PARTS)) == [2 * part * part for part in PARTS]

    def test_work_has_one_thread_as_in_other_processes(self):
        assert set(run_serial(threads, None, [0])) == {1}


class TestProcesses:
    def test_every_part_is_done_once(self):
        assert sorted(run_processes(square, 2, PARTS, 2)) == [2 * part * part for part in PARTS]

    def test_several_processes_work_with_one_thread_each(self):
        found = set(run_processes(where, None, PARTS, 2))
        assert len(found) == 2
        assert os.getpid() not in found
        assert set(run_processes(threads, None, PARTS[:2], 2)) == {1}

    def test_no_part_is_no_work(self):
        assert list(run_processes(square, 2, [], 2)) == []

    def test_parts_of_workers_that_die_are_done_by_others(self, tmp_path):
        assert sorted(run_processes(die_once, tmp_path, PARTS, 2)) == [part * part for part in PARTS]
        assert {file.name for file in tmp_path.iterdir()} == {"died-3", "died-7"}

    def test_a_worker_that_is_killed_from_outside_loses_nothing(self):
        found = []
        for index, part in enumerate(run_processes(slow, None, PARTS, 2)):
            if index == 1:
                os.kill(next(iter(run_processes_children())), signal.SIGKILL)
            found.append(part)
        assert sorted(found) == PARTS

    def test_workers_may_die_often_in_a_job_that_goes_on(self, tmp_path):
        # five deaths, more than are allowed in a row, each after some part was finished
        assert sorted(run_processes(die_five_times, tmp_path, PARTS, 1)) == [part * part for part in PARTS]

    def test_workers_that_always_die_are_given_up(self):
        found = []
        with pytest.raises(
            WorkerError,
            match="worker processes died 4 times in a row, perhaps for want of memory: use fewer workers; what was "
            "finished is kept, and the same call with resume goes on from there",
        ):
            found.extend(run_processes(die_of_one, None, PARTS, 1))
        assert set(PARTS[:9]) <= set(found)  # what was done before was handed over

    def test_an_error_in_a_part_is_raised_and_nobody_works_on(self):
        with pytest.raises(ZeroDivisionError, match="part five"):
            list(run_processes(fail, None, PARTS, 2))
        assert wait_for(lambda: not run_processes_children())

    def test_who_stops_does_not_wait_for_the_rest(self, tmp_path):
        started = run_processes(log_and_sleep, tmp_path, PARTS, 2)
        next(started)
        started.close()
        ended = [file.name for file in tmp_path.parent.glob(f"{tmp_path.name}-ended-*")]
        assert ended == [f"{tmp_path.name}-ended-0"]  # the others take a minute, and were not waited for
        assert not any(alive(int(file.name)) for file in tmp_path.iterdir())

    @pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="NOT TESTED: needs /proc")
    def test_workers_end_when_the_main_process_is_killed(self, tmp_path):
        script = (
            f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
            "from pathlib import Path\n"
            "from bayes_rs.fits.workers import run_processes\n"
            "from worker_jobs import log_and_sleep\n"
            f"list(run_processes(log_and_sleep, Path({str(tmp_path)!r}), list(range(12)), 2))\n"
        )
        job = subprocess.Popen([sys.executable, "-c", script])  # noqa: S603 - our own script
        try:
            assert wait_for(lambda: len(list(tmp_path.iterdir())) == 2)
        finally:
            job.kill()
            job.wait()
        children = [int(file.name) for file in tmp_path.iterdir()]
        assert wait_for(lambda: not any(alive(child) for child in children), 10.0)


def run_processes_children():
    """Process numbers of the loky workers that this process has."""
    return [
        child.pid
        for child in psutil.Process().children()
        if child.status() != psutil.STATUS_ZOMBIE and "popen_loky" in " ".join(child.cmdline())
    ]


@pytest.fixture(scope="module")
def client():
    with (
        # it closes for good what is not there 15 s after a death: a worker, say, that a later test has just killed
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1 hour"}),
        distributed.LocalCluster(processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster,
        distributed.Client(cluster) as found,
    ):
        yield found


class TestDask:
    def test_every_part_is_done_once(self, client):
        assert sorted(run_dask(square, 2, PARTS, client)) == [2 * part * part for part in PARTS]

    def test_several_workers_work_with_one_thread_each(self, client):
        found = set(run_dask(where, None, PARTS, client))
        assert len(found) == 2
        assert os.getpid() not in found
        assert set(run_dask(threads, None, PARTS[:2], client)) == {1}

    def test_an_error_in_a_part_is_raised(self, client):
        with pytest.raises(ZeroDivisionError, match="part five"):
            list(run_dask(fail, None, PARTS, client))

    def test_parts_of_workers_that_die_are_done_by_others(self, client, tmp_path):
        assert sorted(run_dask(die_once, tmp_path, PARTS, client)) == [part * part for part in PARTS]
        assert {file.name for file in tmp_path.iterdir()} == {"died-3", "died-7"}

    def test_all_workers_may_be_lost_at_once_with_what_they_share(self, client):
        found = []
        for index, part in enumerate(run_dask(slow, None, PARTS, client)):
            if index == 1:
                for worker in client.run(os.getpid).values():
                    os.kill(worker, signal.SIGKILL)
            found.append(part)
        assert sorted(found) == PARTS

    def test_a_part_that_kills_every_worker_is_given_up(self, client):
        with pytest.raises(
            WorkerError, match=r"Dask workers died again and again, perhaps .*; what was finished is kept"
        ):
            list(run_dask(die_of_one, None, PARTS, client))

    def test_a_cluster_without_workers(self):
        with (
            dask.config.set({"distributed.comm.timeouts.connect": "1s"}),
            distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
            distributed.Client(cluster) as client,
            pytest.raises(WorkerError, match=r"The Dask cluster has no worker .*: start some, and wait for them"),
        ):
            list(run_dask(square, 2, PARTS, client))

    @pytest.mark.parametrize("client", ["tcp://127.0.0.1:8786", 3])
    def test_what_is_no_client(self, client):
        with pytest.raises(InputError, match=r"Invalid client .*: it must be a dask.distributed.Client, not an asynch"):
            list(run_dask(square, 2, PARTS, client))

    def test_without_the_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(InputError, match=r'needs the package distributed: run pip install "bayes_rs\[dask\]"'):
            list(run_dask(square, 2, PARTS, object()))
