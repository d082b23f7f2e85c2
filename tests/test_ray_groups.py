"""Rows to rays: what the vectorised grouping gives is what a slow loop over the rows gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_rs.errors import InputError
from bayes_rs.file_options import FileOptions
from bayes_rs.readers.format import resolve_format
from bayes_rs.readers.ray_groups import GateRows, ray_and_gate, rays_of_rows

PLAIN = resolve_format(FileOptions(), None)
START = np.datetime64("2024-01-01", "ns")


def slow_rays(time, azimuth, elevation, distance):
    """For each ray the indices of its rows, nearest gate first; rays in the order of their first rows."""
    rays = []
    for index, key in enumerate(zip(time, azimuth, elevation, strict=True)):
        for ray in rays:
            if ray["key"] == key and distance[index] not in ray["distance"]:
                ray["rows"].append(index)
                ray["distance"].append(distance[index])
                break
        else:
            rays.append({"key": key, "rows": [index], "distance": [distance[index]]})
    return [sorted(ray["rows"], key=lambda row: distance[row]) for ray in rays]


ROWS = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 2), st.integers(0, 1), st.integers(1, 5)), min_size=1, max_size=40
)


def columns_of(rows):
    second, azimuth, elevation, gate = np.array(rows, dtype=float).T
    return START + (1e9 * second).astype("timedelta64[ns]"), 30.0 * azimuth, 45.0 * elevation, 50.0 * gate


@settings(deadline=None, max_examples=300)
@given(ROWS)
def test_the_rays_are_those_of_a_slow_loop(rows):
    time, azimuth, elevation, distance = columns_of(rows)
    ray, gate, first = ray_and_gate(time, azimuth, elevation, distance)
    got = [
        [int(row) for row in sorted(np.flatnonzero(ray == number), key=lambda row: gate[row])]
        for number in range(len(first))
    ]
    wanted = slow_rays(time.tolist(), azimuth.tolist(), elevation.tolist(), distance.tolist())
    assert got == wanted
    assert first.tolist() == [min(rows_of_ray) for rows_of_ray in wanted]
    for number in range(len(first)):
        assert sorted(gate[ray == number]) == list(range(int((ray == number).sum())))


@settings(deadline=None, max_examples=100)
@given(ROWS)
def test_no_row_is_lost(rows):
    time, azimuth, elevation, distance = columns_of(rows)
    velocity = np.arange(1.0, len(time) + 1.0)
    table = GateRows(
        time, azimuth, elevation, distance, velocity, -velocity, None, np.zeros(len(time), dtype=bool),
        np.arange(len(time)),
    )  # fmt: skip
    rays = rays_of_rows(table, "a.csv", PLAIN, kind="rays", row_word="line", left_out={}, facts={})
    held = rays.radial_velocity[~np.isnan(rays.radial_velocity)]
    np.testing.assert_array_equal(np.sort(held), velocity)
    np.testing.assert_array_equal(rays.cnr, -rays.radial_velocity)
    for gates in rays.distance:
        assert (np.diff(gates[~np.isnan(gates)]) > 0.0).all()


def test_missing_angles_and_times_are_keys_too():
    time = np.array(["2024-01-01", "NaT", "NaT", "2024-01-01"], dtype="datetime64[ns]")
    ray, gate, _ = ray_and_gate(time, np.full(4, np.nan), np.zeros(4), np.array([50.0, 50.0, 100.0, 100.0]))
    assert (ray.tolist(), gate.tolist()) == ([0, 1, 1, 0], [0, 0, 1, 1])


def test_rows_that_are_no_rays_are_refused_before_they_fill_the_memory():
    n = 40_000
    time = np.where(np.arange(n) < n // 2, START, START + np.arange(n).astype("timedelta64[s]"))
    values = np.zeros(n)
    table = GateRows(
        time, values, values, 1.0 + np.arange(n), values, None, None, np.zeros(n, dtype=bool), np.arange(n)
    )
    with pytest.raises(InputError, match=r"has 20000 rows of one time and direction, and 20001 times .* no rays with"):
        rays_of_rows(table, "a.csv", PLAIN, kind="rays", row_word="line", left_out={}, facts={})
