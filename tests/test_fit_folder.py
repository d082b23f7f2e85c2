"""Fits in folders: the numbers of those in memory, however the work is cut, shared out, interrupted and resumed."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import ClassVar

import distributed
import fit_scene
import numpy as np
import pandas as pd
import pytest
from fit_scene import EMPTY_PART, N_RECORD, NOISE, OPTIONS, PART, SCAN, fit_to, make_records

from bayes_rs import STRESSES, InputError, MannTurbulence, Nuisances, fit, load_scan, open_fit
from bayes_rs.fits import fit_writing, plan
from bayes_rs.fits import parts as fit_parts
from bayes_rs.fits.flags import FLAGS
from bayes_rs.fits.tables import part_names
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.result_folder import open_result_folder

pytestmark = pytest.mark.slow
TESTS = Path(__file__).parent
MONTH = "month=2020-01"
UNFITTED = [2, 8, *range(10, 15)]
OWN = ("run.json", "fingerprints.jsonl")
"""Files that hold the time that a run took."""


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(plan, "PART_RECORDS", PART)


@pytest.fixture(scope="module")
def records():
    return make_records()


@pytest.fixture(scope="module")
def result(records):
    return fit(records, SCAN, **OPTIONS)


@pytest.fixture(scope="module")
def table(result):
    return result.summary(derived=("ti", "tke"))


@pytest.fixture(scope="module")
def whole(records, tmp_path_factory):
    """The folder of an uninterrupted run, with draws and derived quantities."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "PART_RECORDS", PART)
        fit_to(records, SCAN, folder, derived=("ti", "tke"), draws="float64", **OPTIONS)
    return folder


@pytest.fixture(scope="module")
def plain(records, tmp_path_factory):
    """The folder of an uninterrupted run with nothing but the defaults."""
    folder = tmp_path_factory.mktemp("plain") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "PART_RECORDS", PART)
        fit_to(records, SCAN, folder, **OPTIONS)
    return folder


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster,
        distributed.Client(cluster) as found,
    ):
        yield found


def same(one, other):
    """Check that two tables are the same, bit by bit."""
    pd.testing.assert_frame_equal(one, other, check_exact=True)


def same_folders(one, other):
    """Check that two runs left the same files, bit by bit; run.json may differ in the times and the work of a run."""
    found = [contents(folder) for folder in (one, other)]
    assert list(found[0]) == list(found[1])
    for name, content in found[0].items():
        assert content == found[1][name], name
    runs = [open_result_folder(folder).run() for folder in (one, other)]
    for run in runs:
        del run["seconds"], run["n_resumed"]
    assert runs[0] == runs[1]


def contents(folder):
    """The bytes of all files, but of run.json and of the list that knows its fingerprint."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files if file.name not in OWN}


def parts(folder, name="summary"):
    return {file.name: file.stat().st_mtime_ns for file in (folder / name).glob("**/part-*.parquet")}


def run_that_dies(folder, *, workers, number, draws="none"):
    """Run the fit in a process that is killed in the middle of writing its file of that number."""
    command = [sys.executable, TESTS / "fit_scene.py", folder, str(workers), str(number), draws]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)  # noqa: S603 - our own
    assert done.returncode == -signal.SIGKILL, done.stderr


class TestNumbers:
    def test_the_summary_is_that_of_fit_bit_by_bit(self, whole, table):
        same(open_fit(whole).summary(), table)

    def test_emcee_had_a_share_in_it(self, result):
        assert set(result["sample_stats"]["sampler"].values) == {"", "direct", "emcee"}

    def test_the_posterior_table_is_that_of_fit(self, whole, result):
        found = pd.read_parquet(whole / "posterior")
        stats = result["sample_stats"]
        for name in ("acceptance_rate", "n_step", "pareto_k", "misfit"):
            np.testing.assert_array_equal(found[name], stats[name].values)
        np.testing.assert_array_equal(found["sampler"], stats["sampler"].values)
        np.testing.assert_array_equal(found["flag_bits"], stats["flag"].values)
        np.testing.assert_array_equal(found["time"], result["observed_data"]["time"].values)

    def test_the_target_sonic_has_the_numbers_of_fit_too(self, tmp_path):
        scan, flow = load_scan("6-beam"), MannTurbulence(0.05, 61.0, 3.2)
        noise = theory_noise(scan, flow, wind_speed=10.0, sonic=True)
        records = make_records(4)
        options = {**OPTIONS, "noise": noise, "target": "sonic"}
        done = fit_to(records, scan, tmp_path / "sonic", **options)
        same(done.summary(), fit(records, scan, **options).summary())

    def test_the_covariances_are_those_of_the_draws(self, whole, result):
        found = pd.read_parquet(whole / "posterior")
        draws = result["posterior"]["stress"].transpose("record", "component", "chain", "draw").values
        for record in (0, 4, 22):
            expected = np.cov(draws[record].reshape(6, -1))
            for i, one in enumerate(STRESSES):
                for j, other in enumerate(STRESSES[i:], i):
                    # rounding of 2048 products, relative to the scale of the two
                    scale = np.sqrt(expected[i, i] * expected[j, j])
                    assert abs(found[f"cov_{one}_{other}"][record] - expected[i, j]) < 1e-12 * scale

    @pytest.mark.parametrize("kind", ["float64", "float32"])
    def test_the_draws_are_those_of_fit(self, records, whole, result, tmp_path, kind):
        folder = whole
        if kind == "float32":
            folder = Path(fit_to(records, SCAN, tmp_path / "out", draws=kind, **OPTIONS).place)
        found = pd.read_parquet(folder / "draws")
        posterior = result["posterior"]["stress"].transpose("record", "chain", "draw", "component").values
        fitted = np.setdiff1d(np.arange(N_RECORD), UNFITTED)
        expected = posterior[fitted].reshape(-1, 6).astype(kind)
        np.testing.assert_array_equal(found[list(STRESSES)].to_numpy(), expected)
        assert {str(found[name].dtype) for name in STRESSES} == {kind}
        n_draw = len(expected) // len(fitted)
        np.testing.assert_array_equal(found["record"], np.repeat(fitted, n_draw))
        n_chain = result.run["n_chain"]
        expected = np.divmod(np.tile(np.arange(n_draw), len(fitted)), n_draw // n_chain)
        np.testing.assert_array_equal(found[["chain", "draw"]].to_numpy().T, expected)

    @pytest.mark.parametrize("size", [1, 7, 512])
    def test_the_size_of_a_part_changes_no_number(self, records, plain, monkeypatch, tmp_path, size):
        monkeypatch.setattr(plan, "PART_RECORDS", size)
        found = fit_to(records, SCAN, tmp_path / "out", **OPTIONS)
        same(found.summary(), open_fit(plain).summary())
        assert len(parts(Path(found.place))) == -(-N_RECORD // size)

    def test_emcee_alone_and_other_options_reach_the_sampler(self, records, tmp_path):
        options = {
            "sampler": "emcee",
            "prior": "flat",
            "target": "ensemble",
            "instrument_noise": 0.01,
            "nuisances": Nuisances(yaw_sd_deg=2.0, inflation=1.2),
        }
        some = records.isel(record=slice(0, 7))
        found = fit_to(some, SCAN, tmp_path / "out", prob=0.5, **{**OPTIONS, **options})
        same(found.summary(), fit(some, SCAN, **{**OPTIONS, **options}).summary(prob=0.5))

    def test_records_without_time(self, records, tmp_path):
        some = records.isel(record=slice(0, 7)).drop_vars("time")
        found = fit_to(some, SCAN, tmp_path / "out", **OPTIONS)
        same(found.summary(), fit(some, SCAN, **OPTIONS).summary())
        assert found.summary()["time"].isna().all()

    def test_records_outside_the_noise_bank_are_marked(self, records, tmp_path):
        some = records.isel(record=slice(0, 4)).assign(wind_speed=("record", [10.0, 30.0, np.nan, 10.0]))
        slower = replace(NOISE, wind_speed=9.0)
        options = {**OPTIONS, "noise": Noise.join((slower, NOISE))}
        folder = Path(fit_to(some, SCAN, tmp_path / "out", **options).place)
        assert pd.read_parquet(folder / "posterior")["outside_noise"].tolist() == [False, True, False, False]
        assert json.loads((folder / "run.json").read_text())["flags"]["outside_noise"] == 1
        assert fit(some, SCAN, **options).attrs["n_outside_noise"] == 1


class TestRecordsThatCannotBeFitted:
    def test_they_stay_with_their_flags(self, whole):
        found = open_fit(whole).summary()
        assert found["record"].nunique() == N_RECORD
        of = found.groupby("record")
        assert np.flatnonzero(of["mean"].first().isna()).tolist() == UNFITTED
        assert of["flag"].first()[2] == "no_wind"
        assert of["flag"].first()[8] == "no_usable_beam"
        assert of["flag"].first()[4] == "beam_left_out"
        assert found["time"].notna().all()

    def test_they_are_counted(self, records, tmp_path):
        found = fit_to(records, SCAN, tmp_path / "out", **OPTIONS)
        assert (found.n_record, found.n_fitted, found.run["n_resumed"]) == (N_RECORD, N_RECORD - len(UNFITTED), 0)
        assert found.flags["no_usable_beam"] == 6
        assert found.flags["no_wind"] == 1
        assert found.flags["beam_left_out"] == 1
        assert set(found.flags) == set(FLAGS)

    def test_none_at_all_can_be_fitted(self, records, tmp_path):
        some = records.isel(record=EMPTY_PART)
        found = fit_to(some, SCAN, tmp_path / "out", draws="float32", **OPTIONS)
        assert found.n_fitted == 0
        same(found.summary(), fit(some, SCAN, **OPTIONS).summary())
        assert len(pd.read_parquet(Path(found.place) / "draws")) == 0

    def test_every_part_has_the_same_types(self, whole):
        for name in ("summary", "posterior", "draws"):
            types = {
                str(pd.read_parquet(whole / file).dtypes.to_dict())
                for file in part_names(open_result_folder(whole), name)
            }
            assert len(types) == 1, name


class TestFolder:
    def test_pandas_reads_a_dataset_as_one_table_in_the_order_of_the_records(self, whole):
        for name in ("summary", "posterior", "draws"):
            found = pd.read_parquet(whole / name)
            assert found["record"].is_monotonic_increasing
            assert "datetime64[ns]" in {str(kind) for kind in found.dtypes} or name == "draws"
        same(pd.read_parquet(whole / "summary" / MONTH), open_fit(whole).summary())
        same(pd.read_parquet(whole / "summary").drop(columns="month"), open_fit(whole).summary())
        assert len(pd.read_parquet(whole / "posterior")) == N_RECORD

    def test_run_file_tells_what_was_run(self, plain):
        run = json.loads((plain / "run.json").read_text())
        assert run["finished"] is True
        own = run["settings"]["fit"]
        assert (own["sampler"], own["likelihood"], run["nuisances"]) == ("auto", "log-normal", "nothing but R")
        assert (own["seed"], own["target_ess"], own["prob"], run["n_record"]) == (3, 200, 0.9, N_RECORD)
        assert run["noise"]["method"] == "given"
        assert run["prior"].startswith("weak")

    def test_a_folder_without_a_fit(self, tmp_path):
        with pytest.raises(InputError, match=r"No results in .*: it has no fingerprints.jsonl; give the output folder"):
            open_fit(tmp_path)

    def test_memory_does_not_grow_with_the_records(self, tmp_path):
        # 59 MB if the 480 more records' draws (2048 of 60 bytes each) were kept; 25 MB leave room for the allocator
        script = (
            "import resource, sys\n"
            f"sys.path.insert(0, {str(TESTS)!r})\n"
            "from fit_scene import OPTIONS, SCAN, fit_to, make_records\n"
            "from bayes_rs.fits import fit_writing, plan\n"
            "plan.PART_RECORDS = 64\n"
            "fit_writing.MOST_KEPT = 0\n"  # as of a long fit: no export of all draws at once
            "options = {**OPTIONS, 'sampler': 'direct', 'campaign': 'off'}\n"
            "fit_to(make_records(int(sys.argv[1])), SCAN, sys.argv[2], draws='float64', **options)\n"
            "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)\n"
        )
        peak = [
            float(
                subprocess.run(  # noqa: S603 - our own script
                    [sys.executable, "-c", script, str(n_record), tmp_path / str(n_record)],
                    check=True,
                    capture_output=True,
                    timeout=120,
                ).stdout
            )
            for n_record in (160, 640)
        ]
        assert peak[1] - peak[0] < 25.0  # MiB


class TestMonths:
    """A part that holds records of two months is two files."""

    DIRECT: ClassVar = {**OPTIONS, "sampler": "direct"}

    @pytest.fixture
    def straddling(self, records):
        turn = np.datetime64("2020-03-01", "ns") - 8 * np.timedelta64(600, "s")
        return records.assign_coords(time=("record", turn + np.arange(N_RECORD) * np.timedelta64(600, "s")))

    def test_each_can_be_read_alone(self, straddling, tmp_path):
        found = fit_to(straddling, SCAN, tmp_path / "out", draws="float32", **self.DIRECT)
        same(found.summary(), fit(straddling, SCAN, **self.DIRECT).summary())
        for name in ("summary", "posterior", "draws"):
            for month, expected in (("2020-02", range(8)), ("2020-03", range(8, N_RECORD))):
                some = pd.read_parquet(Path(found.place) / name / f"month={month}")
                assert set(some["record"]) == set(expected) - (set(UNFITTED) if name == "draws" else set())
                chosen = pd.read_parquet(Path(found.place) / name, filters=[("month", "==", month)])
                same(chosen.drop(columns="month"), some)

    def test_a_part_is_whole_only_with_both(self, straddling, tmp_path):
        folder = Path(fit_to(straddling, SCAN, tmp_path / "out", **self.DIRECT).place)
        (folder / "summary" / "month=2020-03" / "part-000001.parquet").unlink()
        before = pd.read_parquet(folder / "summary")
        assert fit_to(straddling, SCAN, folder, resume=True, **self.DIRECT).run["n_resumed"] == N_RECORD - PART
        assert len(open_fit(folder).summary()) == len(before) + 2 * 6


class TestVersions:
    def test_they_are_told(self, plain):
        packages = json.loads((plain / "run.json").read_text())["packages"]
        assert packages == {name: version(name) for name in ("numpy", "scipy", "emcee", "xarray", "pandas")}

    def test_a_run_is_not_resumed_under_others(self, records, tmp_path, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr(plan, "version", lambda name: "1.0" if name == "scipy" else version(name))
            fit_to(records.isel(record=slice(0, 2)), SCAN, tmp_path / "out", **OPTIONS)
        words = "is of a run that differs in scipy, so it cannot be resumed: give the same, another name, or overwrite"
        with pytest.raises(InputError, match=words):
            fit_to(records.isel(record=slice(0, 2)), SCAN, tmp_path / "out", resume=True, **OPTIONS)
        # the file that says so may be lost: the list of files knows it, too
        (tmp_path / "out" / "run.json").unlink()
        with pytest.raises(InputError, match=words):
            fit_to(records.isel(record=slice(0, 2)), SCAN, tmp_path / "out", resume=True, **OPTIONS)


class TestRecordsWhoseLikelihoodFails:
    """They are flagged, and the others have the numbers that they have without them."""

    @pytest.mark.parametrize("bad", [[3], [3, 9, 16], list(range(N_RECORD))])
    def test_they_stop_nothing(self, records, plain, monkeypatch, tmp_path, bad):
        monkeypatch.setattr(fit_parts, "fit_batch", fit_scene.singular(records, bad))
        found = fit_to(records, SCAN, tmp_path / "out", draws="float64", **OPTIONS)
        failed = sorted(set(bad) - set(UNFITTED))
        assert found.flags["likelihood_failed"] == len(failed)
        assert found.n_fitted == N_RECORD - len(UNFITTED) - len(failed)
        table, expected = found.summary(), open_fit(plain).summary()
        spoilt = table["record"].isin(failed)
        assert table[spoilt]["mean"].isna().all()
        assert table[spoilt]["flag"].str.contains("likelihood_failed").all()
        same(table[~spoilt], expected[~spoilt])

    def test_an_infinite_variance_counts_as_none(self, records, tmp_path):
        some = records.isel(record=slice(0, 7)).copy(deep=True)
        some["variance"].values[0, 2] = np.inf
        some["variance"].values[1] = np.nan
        found = fit_to(some, SCAN, tmp_path / "out", **OPTIONS).summary().groupby("record")["flag"].first()
        assert found[0].startswith("beam_left_out")
        assert found[1] == "no_usable_beam"


class TestResume:
    @pytest.mark.parametrize(("workers", "number"), [(1, 5), (2, 4)])
    def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_bits(self, records, plain, tmp_path, workers, number):
        folder = tmp_path / "out"
        run_that_dies(folder, workers=workers, number=number)
        before = {name: parts(folder, name) for name in ("summary", "posterior")}
        # each part is two files: the file with that number is not there, but in its place a half-written one
        assert (len(before["summary"]), len(before["posterior"])) == (-(-number // 2), number // 2)
        assert len(list(folder.glob("**/.half.*"))) == 1
        assert json.loads((folder / "run.json").read_text())["finished"] is False
        both = set(before["summary"]) & set(before["posterior"])
        found = fit_to(records, SCAN, folder, resume=True, **OPTIONS)
        assert found.run["n_resumed"] == number // 2 * PART
        after = {name: parts(folder, name) for name in ("summary", "posterior")}
        for name in ("summary", "posterior"):
            assert {file: before[name][file] for file in both} == {file: after[name][file] for file in both}
        same_folders(folder, plain)
        assert not list(folder.glob("**/.half.*"))

    def test_an_interrupted_run_is_no_fit_yet_and_its_finished_tables_can_be_read(self, plain, tmp_path):
        run_that_dies(tmp_path / "out", workers=1, number=5)
        words = f"The fit in '{tmp_path / 'out'}' has not ended: resume it, or wait for its end."
        with pytest.raises(InputError, match=f"^{re.escape(words)}$"):
            open_fit(tmp_path / "out")
        found = pd.read_parquet(tmp_path / "out" / "summary" / MONTH)
        assert found["record"].unique().tolist() == list(range(3 * PART))
        same(found, open_fit(plain).summary()[: len(found)])

    def test_a_finished_run_is_not_done_again(self, records, plain, monkeypatch):
        monkeypatch.setattr(fit_writing, "fit_part", None)
        before = parts(plain)
        found = fit_to(records, SCAN, plain, resume=True, **OPTIONS)
        assert (found.run["n_resumed"], found.n_fitted) == (N_RECORD, N_RECORD - len(UNFITTED))
        assert parts(plain) == before

    def test_a_part_that_cannot_be_read_is_done_again(self, records, plain, tmp_path):
        folder = Path(fit_to(records, SCAN, tmp_path / "out", **OPTIONS).place)
        spoilt = folder / "posterior" / MONTH / "part-000001.parquet"
        spoilt.write_bytes(spoilt.read_bytes()[:-10])
        (folder / "summary" / MONTH / "part-000003.parquet").write_bytes(b"")
        found = fit_to(records, SCAN, folder, resume=True, **OPTIONS)
        assert found.run["n_resumed"] == N_RECORD - 2 * PART
        same_folders(folder, plain)

    def test_resume_begins_where_there_is_nothing(self, records, tmp_path):
        assert fit_to(records, SCAN, tmp_path / "new" / "out", resume=True, **OPTIONS).run["n_resumed"] == 0

    @pytest.mark.parametrize(
        "change",
        [
            {"seed": 4},
            {"prior": "flat"},
            {"sampler": "direct"},
            {"prob": 0.5},
            {"derived": ("tke",)},
            {"draws": "float32"},
            {"nuisances": Nuisances(yaw_sd_deg=1.0)},
            {"target_ess": 201},
        ],
    )
    def test_other_options_are_refused(self, records, plain, change):
        before = parts(plain)
        name = next(iter(change)).replace("_", " ")
        with pytest.raises(InputError, match=f"is of a run that differs in {name}, so it cannot be resumed: give the"):
            fit_to(records, SCAN, plain, resume=True, **{**OPTIONS, **change})
        assert parts(plain) == before

    def test_other_data_are_refused(self, records, plain):
        other = records.copy(deep=True)
        other["variance"].values[22, 5] *= 1.0 + 1e-15
        later = records.assign_coords(time=records["time"] + np.timedelta64(1, "s"))
        flow = MannTurbulence(dissipation=0.05, length_scale=60.0, gamma=3.2)
        turned = replace(NOISE, turbulence=flow, length_scale=60.0)
        for data, noise, what in (
            (other, NOISE, "records"),
            (later, NOISE, "records"),
            (records.isel(record=slice(0, 22)), NOISE, "records"),
            (records, turned, "noise"),
            (later, turned, "noise and records"),
        ):
            with pytest.raises(InputError, match=f"is of a run that differs in {what}, so it cannot be resumed"):
                fit_to(data, SCAN, plain, resume=True, **{**OPTIONS, "noise": noise})

    def test_an_existing_folder_is_refused_and_kept(self, records, plain, tmp_path):
        before = parts(plain)
        with pytest.raises(InputError, match="from a run of the same data and options: resume to go on with it, or ov"):
            fit_to(records, SCAN, plain, **OPTIONS)
        with pytest.raises(InputError, match=r"exists: give another name, or overwrite it"):
            fit_to(records, SCAN, plain, **{**OPTIONS, "seed": 9})
        assert parts(plain) == before
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "thesis.txt").write_text("years of work")
        for options in ({"overwrite": True}, {"resume": True}, {"resume": True, "overwrite": True}):
            with pytest.raises(InputError, match=r"was not made by bayes-rs|exists: give another name"):
                fit_to(records, SCAN, tmp_path / "mine", **options, **OPTIONS)
        assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"

    @pytest.mark.parametrize("resume", [False, True])
    def test_overwrite_begins_anew(self, records, plain, tmp_path, resume):
        folder = tmp_path / "out"
        some = records.isel(record=slice(0, PART))
        fit_to(records.isel(record=EMPTY_PART), SCAN, folder, draws="float32", **OPTIONS)
        found = fit_to(some, SCAN, folder, overwrite=True, resume=resume, **OPTIONS)
        assert found.run["n_resumed"] == 0
        same(found.summary(), open_fit(plain).summary()[: 6 * PART])
        assert not (folder / "draws").exists()


class TestFailures:
    @pytest.mark.parametrize("workers", [1, 2])
    def test_an_error_in_a_part_keeps_the_finished_ones_and_says_how_to_go_on(
        self, records, plain, monkeypatch, tmp_path, workers
    ):
        monkeypatch.setattr(fit_writing, "fit_part", fit_scene.fail_at_part_three)
        with pytest.raises(ZeroDivisionError, match="part three") as caught:
            fit_to(records, SCAN, tmp_path / "out", workers=workers, **OPTIONS)
        kept = parts(tmp_path / "out", "posterior")
        assert "part-000003.parquet" not in kept
        if workers == 1:
            assert len(kept) == 3
        (note,) = caught.value.__notes__
        assert note == (
            f"{PART * len(kept)} of {N_RECORD} records are finished and kept in {str(tmp_path / 'out')!r}: the same "
            "call with resume goes on from there."
        )
        monkeypatch.undo()
        monkeypatch.setattr(plan, "PART_RECORDS", PART)
        found = fit_to(records, SCAN, tmp_path / "out", resume=True, **OPTIONS)
        assert found.run["n_resumed"] == PART * len(kept)
        same_folders(Path(found.place), plain)

    @pytest.mark.parametrize("workers", [1, 2])
    def test_a_full_disk_keeps_the_finished_parts(self, records, plain, monkeypatch, tmp_path, workers):
        write = Path.write_bytes

        def full(path, content):
            if path.name.startswith(".half.part-") and len(parts(tmp_path / "out")) == 2:
                write(path, b"PAR1")
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return write(path, content)

        monkeypatch.setattr(Path, "write_bytes", full)
        with pytest.raises(OSError, match="No space left on device") as caught:
            fit_to(records, SCAN, tmp_path / "out", workers=workers, **OPTIONS)
        assert "with resume goes on from there" in caught.value.__notes__[0]
        assert not list((tmp_path / "out").glob("**/.half.*"))
        monkeypatch.setattr(Path, "write_bytes", write)
        assert fit_to(records, SCAN, tmp_path / "out", resume=True, **OPTIONS).run["n_resumed"] == PART
        same_folders(tmp_path / "out", plain)

    def test_a_folder_that_cannot_be_written_is_told_before_the_work(self, records, monkeypatch, tmp_path):
        def refused(*_args, **_options):
            raise PermissionError(errno.EACCES, "Permission denied")

        fit_to(records.isel(record=slice(0, 2)), SCAN, tmp_path / "out", **OPTIONS)
        monkeypatch.setattr(fit_writing, "fit_part", None)
        monkeypatch.setattr("bayes_rs.result_folder.ResultFolder.write_run", refused)
        for name, options in (("new", {}), ("out", {"resume": True})):
            with pytest.raises(
                InputError, match=r"Cannot write the output folder .*: Permission denied; give a folder"
            ):
                fit_to(records.isel(record=slice(0, 2)), SCAN, tmp_path / name, **options, **OPTIONS)
        assert not (tmp_path / "new").exists()

    def test_two_processes_and_one_that_is_killed_change_no_number(self, records, plain, monkeypatch, tmp_path):
        monkeypatch.setenv("BAYES_RS_TEST_DIED", str(tmp_path / "died"))
        monkeypatch.setattr(fit_writing, "fit_part", fit_scene.fit_part_and_die_once)
        found = fit_to(records, SCAN, tmp_path / "out", workers=2, **OPTIONS)
        assert (tmp_path / "died").exists()
        same_folders(Path(found.place), plain)

    @pytest.mark.parametrize(
        ("option", "text"),
        [
            ({"draws": "all"}, "Unknown draws 'all': it must be one of auto, none, float32, float64"),
            ({"workers": 0}, "Invalid workers 0: it must be a whole number of at least 1"),
            ({"prob": 90}, "Invalid prob 90: it must be between 0 and 1"),
            ({"client": 8786}, "Invalid client 8786: it must be a dask.distributed.Client"),
            ({"sampler": "nuts"}, "Unknown sampler 'nuts'"),
        ],
    )
    def test_bad_options_are_refused_before_a_folder_is_made(self, records, tmp_path, option, text):
        with pytest.raises(InputError, match=text):
            fit_to(records, SCAN, tmp_path / "out", **{**OPTIONS, **option})
        assert not (tmp_path / "out").exists()

    def test_a_client_without_the_package(self, records, monkeypatch, tmp_path):
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(InputError, match=r"A Dask client needs the package distributed: run pip install"):
            fit_to(records, SCAN, tmp_path / "out", client=object(), **OPTIONS)
        assert not (tmp_path / "out").exists()


class TestDask:
    def test_a_cluster_writes_the_same_files(self, records, plain, client, tmp_path):
        found = fit_to(records, SCAN, tmp_path / "out", client=client, **OPTIONS)
        same_folders(Path(found.place), plain)

    @pytest.mark.usefixtures("short_campaign")
    def test_a_campaign_is_the_same_on_a_cluster(self, records, client, tmp_path):
        more = {**OPTIONS, "campaign": "on"}
        found = [
            fit_to(records, SCAN, tmp_path / name, **more, **way)
            for name, way in (("alone", {}), ("cluster", {"client": client}))
        ]
        assert found[0].has_campaign
        same_folders(Path(found[1].place), Path(found[0].place))

    def test_a_worker_that_is_killed_changes_no_number(self, records, plain, client, monkeypatch, tmp_path):
        client.run(fit_scene.set_variable, "BAYES_RS_TEST_DIED", str(tmp_path / "died"))
        monkeypatch.setattr(fit_writing, "fit_part", fit_scene.fit_part_and_die_once)
        found = fit_to(records, SCAN, tmp_path / "out", client=client, **OPTIONS)
        assert (tmp_path / "died").exists()
        same_folders(Path(found.place), plain)
