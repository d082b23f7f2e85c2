"""Files read ahead, by one process or several: the same numbers, in the same order, each file once."""

from __future__ import annotations

import json
import logging
import os

import numpy as np
import pytest
import xarray as xr
from ray_checks import FLOW, SIX
from ray_files import rays_of, windcube_sweep, write_windcube

from bayes_rs import Settings, save_scan
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.cli.records_of_files import series_of
from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.fits import from_files
from bayes_rs.readers import ahead, netcdf_file, netcdf_guard, read, reading
from bayes_rs.records import record_store
from bayes_rs.records.file_queue import FileQueue, NotInOrderError
from bayes_rs.records.making import make_records
from bayes_rs.records.record_store import store_records
from bayes_rs.simulation.virtual import simulate

N_FILE = 12


@pytest.fixture(scope="module")
def series():
    return simulate(SIX, FLOW, wind_speed=8.0, n_records=3, seed=4)


@pytest.fixture(scope="module")
def table(series):
    return rays_of(series, SIX)


@pytest.fixture(scope="module")
def right(series):
    """The records of the series."""
    return make_records(series, SIX)


ORDERS = {
    "by name": None,
    "turned": list(range(N_FILE))[::-1],
    "mixed": [7 * i % N_FILE for i in range(N_FILE)],
}


@pytest.fixture(scope="module")
def ordered(request, table, tmp_path_factory):
    """A folder of the files, named in an order."""
    return write(tmp_path_factory.mktemp("ordered"), table, order=ORDERS[request.param])


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(ahead, "_FEWEST", 4)
    monkeypatch.setattr(ahead, "_SHARE", 3)


def write(folder, table, *, order=None, damaged=()):
    """Files that follow each other, named in an order; some are cut off."""
    edges = np.linspace(0, len(table.seconds), N_FILE + 1).astype(int)
    for number, place in enumerate(order or range(N_FILE)):
        part = table.take(slice(edges[number], edges[number + 1]))
        file = write_windcube(folder / f"{place:03d}.nc", windcube_sweep(part))
        if number in damaged:
            file.write_bytes(file.read_bytes()[:-500])
    return folder


def stored(folder, files, scan=SIX, **options):
    """Records of files, made in a folder of results."""
    with begin_result_folder(folder, key="k", key_parts={}) as result:
        return store_records(files, scan, result, progress=False, **options)


class TestTheSame:
    def test_read(self, tmp_path, table):
        write(tmp_path, table, damaged=(3, 11))
        one, two = (read(tmp_path, SIX, workers=workers, on_bad_file="skip") for workers in (1, 2))
        xr.testing.assert_identical(one, two)
        assert [file["name"] for file in json.loads(two.attrs["read_report"])["files_skipped"]] == ["003.nc", "011.nc"]
        with pytest.raises(InputError, match=r"003\.nc' cannot be read as NetCDF"):
            read(tmp_path, SIX, workers=2)
        with pytest.raises(InputError, match="Invalid workers 0"):
            read(tmp_path, SIX, workers=0)

    @pytest.mark.parametrize(
        ("ordered", "workers"),
        [
            ("by name", 1),
            ("turned", 1),
            ("mixed", 1),
            ("mixed", 2),
            *(pytest.param(name, 2, marks=pytest.mark.long) for name in ("by name", "turned")),
        ],
        indirect=["ordered"],
    )
    def test_records_in_a_folder(self, tmp_path, ordered, right, monkeypatch, workers):
        monkeypatch.setattr(record_store, "_LOOK_AHEAD", 4)
        monkeypatch.setattr(record_store, "SAVE_SECONDS", 0.0)
        made = stored(tmp_path / "out", ordered, workers=workers).records
        for name in ("variance", "mean", "wind_speed", "yaw"):
            np.testing.assert_allclose(made[name], right[name], rtol=1e-12, atol=1e-13)
        np.testing.assert_array_equal(made["count"], right["count"])
        assert len(json.loads(made.attrs["read_report"])["files"]) == N_FILE

    def test_records_do_not_depend_on_workers_or_on_what_is_kept(self, tmp_path, table):
        (tmp_path / "files").mkdir()
        write(tmp_path / "files", table, damaged=(5,))
        reading = FileOptions(on_bad_file="skip")
        one = stored(tmp_path / "one", tmp_path / "files", reading=reading)
        two = stored(tmp_path / "two", tmp_path / "files", reading=reading, workers=2)
        small = stored(tmp_path / "three", tmp_path / "files", reading=reading, chunk_rows=50)
        xr.testing.assert_identical(one.records, two.records)
        assert one.bad_files == two.bad_files == small.bad_files
        assert len(one.bad_files) == 1
        assert one.counts == small.counts
        for name in ("variance", "mean", "count", "flag"):
            np.testing.assert_array_equal(one.records[name], small.records[name])

    def test_files_that_overlap(self, tmp_path, table, series):
        """Each cycle is in two files."""
        (tmp_path / "files").mkdir()
        edges = np.linspace(0, len(table.seconds), N_FILE + 1).astype(int)
        for number in range(N_FILE):
            part = table.take(slice(max(edges[number] - 60, 0), edges[number + 1]))
            write_windcube(tmp_path / "files" / f"{number:03d}.nc", windcube_sweep(part))
        made = stored(tmp_path / "out", tmp_path / "files").records
        right = make_records(series, SIX)
        np.testing.assert_array_equal(made["count"], right["count"])
        np.testing.assert_allclose(made["variance"], right["variance"], rtol=1e-12)


def end_at_once(*_):
    """What a process does that is killed."""
    os._exit(1)


class TestOnce:
    def test_no_file_is_read_twice(self, tmp_path, table, monkeypatch):
        (tmp_path / "files").mkdir()
        write(tmp_path / "files", table)
        asked = []
        real = netcdf_guard._guard.ask

        def ask(file, request):
            asked.append((request["do"], file.name))
            return real(file, request)

        monkeypatch.setattr(netcdf_guard._guard, "ask", ask)
        netcdf_file._last.kept = None
        stored(tmp_path / "out", tmp_path / "files")
        assert [name for do, name in asked if do == "glance"] == [f"{number:03d}.nc" for number in range(N_FILE)]

    def test_a_process_that_dies(self, tmp_path, table, monkeypatch, caplog):
        write(tmp_path, table)
        right = read(tmp_path, SIX)
        monkeypatch.setattr(ahead, "_read_share", end_at_once)
        with caplog.at_level(logging.WARNING):
            xr.testing.assert_identical(read(tmp_path, SIX, workers=2), right)
        assert "A process that reads files died; this one reads those that are left." in caplog.messages


class SeenError(Exception):
    """What a function was called with."""


def seen(*_, workers, **__):
    raise SeenError(workers)


class TestTheOption:
    def test_of_records(self, monkeypatch):
        monkeypatch.setattr(reading, "read", seen)
        with pytest.raises(SeenError, match="3"):
            series_of(Settings().changed(files=["a.nc"], workers=3), SIX)

    def test_of_a_fit(self, tmp_path, table, monkeypatch):
        (tmp_path / "files").mkdir()
        write(tmp_path / "files", table)
        save_scan(SIX, tmp_path / "six.toml")
        monkeypatch.setattr(from_files, "store_records", seen)
        asked = Settings().changed(
            files=[str(tmp_path / "files")], scan=str(tmp_path / "six.toml"), output=str(tmp_path / "out"), workers=3
        )
        with pytest.raises(SeenError, match="3"):
            from_files.fit_files(asked)


class TestQueue:
    def queue(self, starts, most, most_rows=10**9, wait=0):
        """Files of one sample a second for ten seconds, by their starts in s; None stands for a bad one."""
        zero = np.datetime64("2020-01-01", "ns")

        def files():
            for number, start in enumerate(starts):
                name = f"{number}.nc"
                if start is None:
                    yield ahead.ReadFile(name, [number], None, InputError("bad"))
                    continue
                times = zero + (start + np.arange(10)) * np.timedelta64(1, "s")
                yield ahead.ReadFile(Named(name), [number], Timed(times))

        return FileQueue(files(), lambda _: zero, np.timedelta64(wait, "s"), most, most_rows)

    def names(self, queue):
        groups = []
        while group := queue.take():
            groups.append([one.path.name for one in group])
            queue.used(max(one.samples.time.max() for one in group))
        return groups

    def test_those_that_follow_each_other_come_together(self):
        assert self.names(self.queue([0, 10, 20, 25, 40], 3)) == [["0.nc", "1.nc", "2.nc"], ["3.nc", "4.nc"]]

    def test_the_order_is_that_of_time(self):
        assert self.names(self.queue([20, 0, 40, 10], 4)) == [["1.nc", "3.nc", "0.nc", "2.nc"]]

    def test_one_that_comes_too_late_is_noticed(self):
        with pytest.raises(NotInOrderError):
            self.names(self.queue([20, 5, 40, 0], 2))
        with pytest.raises(NotInOrderError):
            self.names(self.queue([0, 5, 12], 1))

    def test_bad_ones_are_put_aside(self):
        queue = self.queue([0, None, 10], 2)
        assert self.names(queue) == [["0.nc", "2.nc"]]
        assert [(name, key, str(error)) for name, key, error in queue.bad] == [("1.nc", [1], "bad")]

    def test_rows_in_memory_are_bounded(self):
        queue = self.queue(list(range(0, 200, 10)), 20, most_rows=35)
        queue.next_first()
        assert sum(one.samples is not None for one in queue._heap) == 3


class Named(str):
    """A path of which only the name is asked for."""

    __slots__ = ()

    @property
    def name(self):
        return str(self)


class Timed:
    """Samples of which only the times are asked for."""

    def __init__(self, time):
        self.time = time
