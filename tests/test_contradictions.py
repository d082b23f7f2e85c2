"""Distances and heights of gates that contradict each other: put right where it can be known how, else refused."""

from __future__ import annotations

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from ray_checks import FLOW, SIX
from ray_files import RayTable, rays_of, windcube_sweep

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers import find_scan, read
from bayes_rs.readers.contradictions import agree
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.windcube import windcube_rays
from bayes_rs.records.making import make_records
from bayes_rs.records.report import describe_report
from bayes_rs.simulation.virtual import simulate

HEIGHT = np.arange(200.0, 8101.0, 50.0)
ELEVATION = np.array([75.0, 90.0, 75.0, 75.0, 75.0])


def dbs(order=(0, 1, 2, 3, 4), *, n_cycle: int = 1):
    """Distances as a DBS scan's file has them, whole metres, with its rows in an order; elevations and heights."""
    elevation = np.tile(ELEVATION, n_cycle)
    distance = np.trunc(HEIGHT / np.sin(np.deg2rad(elevation))[:, np.newaxis])
    rows = np.concatenate([np.asarray(order) + len(ELEVATION) * cycle for cycle in range(n_cycle)])
    return distance[rows], elevation, np.tile(HEIGHT, (len(elevation), 1)), distance


class TestAgree:
    def test_what_agrees_stays(self):
        distance, elevation, height, _ = dbs()
        found = agree(distance, elevation, height)
        assert found.distance is distance
        assert not found.reordered

    @pytest.mark.parametrize("order", [(0, 2, 3, 4, 1), (1, 0, 2, 3, 4), (2, 3, 4, 0, 1)])
    @pytest.mark.parametrize("n_cycle", [1, 12])
    def test_rows_in_another_order_are_put_right(self, order, n_cycle):
        distance, elevation, height, right = dbs(order, n_cycle=n_cycle)
        found = agree(distance, elevation, height)
        assert found.reordered
        np.testing.assert_array_equal(found.distance, right)

    @pytest.mark.parametrize("offset", [12.0, 318.0])
    def test_heights_above_something_else_agree(self, offset):
        distance, elevation, height, _ = dbs()
        assert agree(distance, elevation, height + offset).distance is distance

    def test_horizontal_rays_and_missing_numbers(self):
        distance = np.tile(np.arange(100.0, 1000.0, 50.0), (4, 1))
        zero = np.zeros_like(distance)
        assert agree(distance, np.zeros(4), zero).distance is distance
        assert agree(distance, np.full(4, np.nan), zero + 5.0).distance is distance
        assert agree(distance, np.zeros(4), zero * np.nan).distance is distance
        assert agree(distance[:0], np.zeros(0), zero[:0]).distance.shape == (0, 18)

    def test_angles_of_some_hundredths_of_a_degree_off_agree(self):
        distance, elevation, height, _ = dbs()
        assert agree(distance, elevation + 0.03, height).distance is distance

    @pytest.mark.parametrize(
        "change",
        [
            lambda d: 1.05 * d,  # another scale for all rows
            lambda d: np.where(np.arange(5)[:, np.newaxis] == 3, 1.02 * d, d),  # one row that fits no ray
            lambda d: d[[1, 1, 1, 1, 1]],  # the zenith's for all
            lambda d: d[:, ::-1],  # gates inwards
        ],
    )
    def test_no_order_agrees(self, change):
        distance, elevation, height, _ = dbs((0, 2, 3, 4, 1))
        found = agree(change(distance), elevation, height)
        assert found.distance is None
        assert not found.reordered


@pytest.fixture(scope="module")
def table() -> RayTable:
    """The six-beam scan with 100 gates from 60 m on: the zenith's are at other distances than the others'."""
    short = rays_of(simulate(SIX, FLOW, wind_speed=8.0, n_records=1, seed=4), SIX, rough=False).take(slice(0, 60))
    height = np.tile(50.0 + 25.0 * np.arange(100), (60, 1))
    velocity = np.random.default_rng(2).normal(size=height.shape)
    distance = height / np.sin(np.deg2rad(short.elevation))[:, np.newaxis]
    return replace(short, distance=distance, velocity=velocity)


def sweep_of(table, order=None):
    """A WindCube's sweep with the heights of its gates, and the rows of `range` in an order."""
    rise = np.sin(np.deg2rad(table.elevation))[:, np.newaxis]
    sweep = windcube_sweep(table)
    sweep["measurement_height"] = (("time", "gate_index"), np.round(table.distance * rise), {"units": "m"})
    if order is not None:
        rows = (np.arange(0, len(table.seconds), 6)[:, np.newaxis] + np.asarray(order)).ravel()
        sweep["range"] = (("time", "gate_index"), table.distance[rows], {"units": "m"})
    return sweep


class TestFiles:
    def test_the_records_are_those_of_the_right_order(self, tmp_path, table):
        sweep_of(table).to_netcdf(tmp_path / "right.nc", engine="h5netcdf")
        sweep_of(table, (5, 0, 1, 2, 3, 4)).to_netcdf(tmp_path / "turned.nc", engine="h5netcdf")
        scan = find_scan(tmp_path / "right.nc", height=2000.0)
        assert scan.focus_distance == pytest.approx(find_scan(tmp_path / "turned.nc", height=2000.0).focus_distance)
        right, turned = (read(tmp_path / name, scan) for name in ("right.nc", "turned.nc"))
        np.testing.assert_array_equal(turned["radial_velocity"], right["radial_velocity"])
        assert "range_rows_reordered" not in json.loads(right.attrs["read_report"])["files"][0]
        assert (
            "1 file (the first: turned.nc) has the rows of its ranges in another order than its rays, as the heights "
            "of the gates say: the ranges are taken in the order in which they agree (gates_by)"
        ) in describe_report(turned)
        assert "another order" not in " ".join(describe_report(right))
        wrong = read(tmp_path / "turned.nc", scan, gates_by="distance")
        assert not np.array_equal(wrong["radial_velocity"], right["radial_velocity"])

    def test_it_is_told_once_for_all_files(self, tmp_path, table):
        for number in range(3):
            part = table.take(slice(20 * number, 20 * number + 18))
            sweep_of(part, (5, 0, 1, 2, 3, 4)).to_netcdf(tmp_path / f"{number}.nc", engine="h5netcdf")
        records = make_records(read(tmp_path, find_scan(tmp_path, height=500.0)), find_scan(tmp_path, height=500.0))
        told = [line for line in describe_report(records) if "another order than" in line]
        assert len(told) == 1
        assert told[0].startswith("3 files (the first: 0.nc) have the rows of their ranges")

    def test_what_no_order_explains_is_refused(self, tmp_path, table):
        sweep = sweep_of(table)
        sweep["range"] = 1.2 * sweep["range"]
        sweep.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
        with pytest.raises(InputError) as caught:
            find_scan(tmp_path / "a.nc", height=500.0)
        assert str(caught.value) == (
            f"Distances and heights of the gates in file {str(tmp_path / 'a.nc')!r} contradict each other: in ray 6, "
            "at an elevation of 90 degrees, gate 100 has the distance 3030 m in 'range' and the height 2525 m in "
            "'measurement_height', and no other order of the rows agrees; say which to believe with "
            "gates_by='distance' or gates_by='height' (--gates-by)."
        )
        by = {
            name: windcube_rays(tmp_path / "a.nc", resolve_format(FileOptions(gates_by=name), None)).distance
            for name in ("distance", "height")
        }
        np.testing.assert_allclose(by["distance"], 1.2 * table.distance)
        np.testing.assert_allclose(by["height"], table.distance, atol=0.52)  # heights are whole metres


class TestMeasured:
    @pytest.mark.parametrize("height", [200.0, 700.0, 750.0, 2000.0, 8000.0])
    def test_every_gate_is_the_one_at_its_height(self, dbs_folder, height):
        """By h5py and the heights alone, ray by ray; before, gates above 710 m were those beside them."""
        files = sorted(dbs_folder.glob("*.nc"))
        scan = find_scan(files, height=height)
        assert scan.focus_distance * scan.beam_direction[:, 2] == pytest.approx(np.full(5, height), abs=1.5)
        series = read(files, scan)
        velocity = []
        for file in files:
            with h5py.File(file, "r") as opened:
                sweep = next(opened[name] for name in opened if name.startswith("Sweep"))
                at = np.argmin(np.abs(sweep["measurement_height"][()] - height), axis=1)
                velocity.append(sweep["radial_wind_speed"][()][np.arange(5), at])
        np.testing.assert_array_equal(series["radial_velocity"].values, np.concatenate(velocity))
        assert [
            line
            for line in describe_report(series)
            if line.startswith("11 files (the first: WLS200S-218_2021-07-01_13")
        ]

    @pytest.mark.parametrize("height", [200.0, 2000.0])
    def test_what_was_read_before_was_another_gate(self, dbs_folder, height):
        """The option that believes the distances as they stand does what was done in silence."""
        files = sorted(dbs_folder.glob("*.nc"))
        right = read(files, find_scan(files, height=height))["radial_velocity"].values
        other = read(files, find_scan(files, height=height, gates_by="distance"), gates_by="distance")
        assert np.array_equal(other["radial_velocity"].values, right) == (height == 200.0)
