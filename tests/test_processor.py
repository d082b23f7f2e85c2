"""Numbers are the same bit by bit on processors of one kind; where kinds meet, one line says so."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from fit_scene import NOISE, OPTIONS, PART, SCAN, fit_to, make_records
from threadpoolctl import threadpool_info, threadpool_limits

import bayes_rs as brs
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.fits import fit_writing, fitting, parts, plan
from bayes_rs.fits.digest import digest
from bayes_rs.fits.fit_options import split_options
from bayes_rs.fits.noise_choice import fit_inputs, noise_and_records
from bayes_rs.noise import at_states
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.processor import note_processor, one_thread, processor_kind
from bayes_rs.turbulence import two_point

ROOT = Path(__file__).parents[1]
MIXED = "Numbers of this fit come from processors of different kinds"


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(plan, "PART_RECORDS", PART)


def as_other(monkeypatch, kind="another kind"):
    """Have this process seem to run on a processor of another kind."""
    for module in (fit_writing, fitting, parts, at_states):
        monkeypatch.setattr(module, "processor_kind", lambda: kind)


class TestKind:
    def test_it_is_what_numpy_and_blas_found(self):
        for library in threadpool_info():
            if library["user_api"] == "blas" and library.get("architecture"):
                assert f"{library['internal_api']} {library['architecture']}" in processor_kind()
        assert processor_kind() == processor_kind()

    @pytest.mark.skipif(
        not np.show_config(mode="dicts")["SIMD Extensions"].get("found"), reason="NO FEATURES TO TURN OFF"
    )
    def test_a_feature_that_is_off_is_another_kind(self):
        off = " ".join(np.show_config(mode="dicts")["SIMD Extensions"]["found"])
        code = "from bayes_rs.processor import processor_kind; print(processor_kind())"
        environment = {**os.environ, "NPY_DISABLE_CPU_FEATURES": off, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-W", "ignore", "-c", code]
        found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)  # noqa: S603 - ours
        assert found.stdout.strip() != processor_kind()

    def test_one_line_when_kinds_meet(self, caplog):
        kinds = []
        assert note_processor(kinds, "a")
        assert not note_processor(kinds, "a")
        assert caplog.messages == []
        assert note_processor(kinds, "b")
        assert caplog.messages == [
            f"{MIXED} (a; b): they are the same up to their last digits, medians up to 3e-6 of their value."
        ]


@pytest.mark.usefixtures("small_parts")
class TestResume:
    def test_on_the_same_kind_nothing_is_said(self, tmp_path, caplog):
        records = make_records(2 * PART)
        fit_to(records, SCAN, tmp_path / "out", **OPTIONS)
        found = fit_to(records, SCAN, tmp_path / "out", resume=True, **OPTIONS)
        assert MIXED not in caplog.text
        assert found.run["processors"] == [processor_kind()]

    def test_on_another_kind_it_goes_on_and_says_so(self, tmp_path, caplog, monkeypatch):
        records = make_records(2 * PART)
        fit_to(records, SCAN, tmp_path / "out", **OPTIONS)
        (lost,) = (tmp_path / "out" / "posterior").rglob("part-000001.parquet")
        lost.unlink()
        with monkeypatch.context() as patch:
            as_other(patch)
            found = fit_to(records, SCAN, tmp_path / "out", resume=True, **OPTIONS)
        (line,) = [line for line in caplog.messages if MIXED in line]
        assert line.startswith(f"{MIXED} ({processor_kind()}; another kind): they are the same up to their last digits")
        assert found.run["n_resumed"] == PART
        assert found.run["processors"] == [processor_kind(), "another kind"]
        kept = json.loads((tmp_path / "out" / "fit-key.json").read_text())["processors"]
        assert kept == found.run["processors"]

    def test_a_folder_of_before_has_no_kinds(self, tmp_path, caplog):
        records = make_records(2)
        fit_to(records, SCAN, tmp_path / "out", **OPTIONS)
        with begin_result_folder(
            tmp_path / "out", **dict(zip(("key", "key_parts"), key_of(records), strict=True)), resume=True
        ) as folder:
            mark = json.loads(folder.read("fit-key.json"))
            del mark["processors"]
            folder.write_text("fit-key.json", json.dumps(mark))
        found = fit_to(records, SCAN, tmp_path / "out", resume=True, **OPTIONS)
        assert found.run["n_resumed"] == 2
        assert MIXED not in caplog.text


def key_of(records):
    own, choice = split_options({name: value for name, value in OPTIONS.items() if name != "noise"} | {"draws": "none"})
    made = plan.plan_fit(records, SCAN, NOISE, own, inputs=fit_inputs(records, NOISE, choice))
    return made.key, made.key_parts


class TestWorkers:
    def test_workers_of_different_kinds(self, caplog, monkeypatch):
        """The kind comes back with each part: here the second is of another kind."""
        monkeypatch.setattr(plan, "PART_RECORDS", PART)
        kinds = iter([processor_kind(), "another kind"])
        monkeypatch.setattr(
            fitting,
            "fit_part",
            lambda shared, part: parts.Done(part.index, parts.fit_part(shared, part).tables, next(kinds)),
        )
        found = brs.fit(make_records(2 * PART), SCAN, **OPTIONS)
        assert len([line for line in caplog.messages if MIXED in line]) == 1
        assert found.run["processors"] == [processor_kind(), "another kind"]


class TestThreads:
    """No number depends on how many threads BLAS may use, and so no resumed run is refused for it."""

    def test_noise_is_calculated_with_one(self, monkeypatch):
        seen = []

        def counting(*arguments, **options):
            seen.append({library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"})
            return theory_noise(*arguments, **options)

        monkeypatch.setattr(at_states, "theory_noise", counting)
        with threadpool_limits(2):
            brs.noise.calibrate("2-beam", "fu-2022", wind_speed=9.0, duration=60.0, cache=False)
        assert seen == [{1}]

    def test_records_are_prepared_with_one(self, monkeypatch):
        seen = []

        def counting(*arguments, **options):
            seen.append({library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"})
            return noise_and_records(*arguments, **options)

        monkeypatch.setattr(fitting, "noise_and_records", counting)
        with threadpool_limits(2):
            brs.fit(make_records(2), SCAN, **OPTIONS)
        assert seen == [{1}]

    def test_what_is_kept_does_not_depend_on_who_asked_first(self):
        # tables are kept for all later calls: made with two threads by one, they changed the last bits of another
        tables = []
        for n_thread in (1, 2):
            two_point._build_table.cache_clear()
            with threadpool_limits(n_thread):
                tables.append(two_point.covariance_table(3.2, np.array([[300.0, 2.0, 2.0]]), tolerance=1e-4).values)
        np.testing.assert_array_equal(*tables)

    def test_it_gives_back_what_was_set(self):
        with threadpool_limits(2):
            before = threadpool_info()
            with one_thread():
                pass
            assert threadpool_info() == before


class TestKeys:
    def test_a_key_is_of_inputs_and_not_of_what_is_calculated(self):
        """Noise that differs in its last bits, as another processor makes it, is of the same fit."""
        records = make_records(2)
        own, choice = split_options({"seed": 3, "turbulence": "fu-2022"})
        inputs = fit_inputs(records, None, choice)
        other = replace(NOISE, bias=NOISE.bias + 1e-16)
        assert len({plan.plan_fit(records, SCAN, some, own, inputs=inputs).key for some in (NOISE, other)}) == 1

    def test_objects_of_the_users_own_have_one_too(self):
        _, choice = split_options({"seed": 3})
        records = make_records(2)
        first, other = (
            digest(fit_inputs(records.assign(day=("record", [date(2020, 9, day), None])), None, choice))
            for day in (3, 4)
        )
        assert first != other

    @pytest.mark.parametrize(
        "change",
        [
            lambda records: records.assign(variance=records["variance"] * (1.0 + 1e-15)),
            lambda records: records.assign_attrs(duration=601.0),
            lambda records: records.drop_vars("wind_speed"),
        ],
    )
    def test_other_records_are_another_fit(self, change):
        records = make_records(2)
        _, choice = split_options({"seed": 3})
        assert digest(fit_inputs(records, None, choice)) != digest(fit_inputs(change(records), None, choice))

    def test_another_flow_is_another_fit(self):
        records = make_records(2)
        keys = {
            digest(fit_inputs(records, None, split_options({"seed": 3, "turbulence": flow})[1]))
            for flow in ("iec-a", "iec-b")
        }
        assert len(keys) == 2

    def test_cached_noise_is_of_one_kind(self, monkeypatch, tmp_path):
        make = lambda: brs.noise.calibrate("2-beam", "fu-2022", wind_speed=9.0, duration=60.0, cache=tmp_path)  # noqa: E731
        make()
        make()
        assert len(list(tmp_path.glob("*.nc"))) == 1
        as_other(monkeypatch)
        make()
        assert len(list(tmp_path.glob("*.nc"))) == 2
