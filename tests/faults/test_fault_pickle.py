"""No pickle: nothing that is read can run code. Only worker processes of one run pass pickled jobs among themselves."""

import ast
import pickle
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

import bayes_rs
from bayes_rs.begin_folder import begin_result_folder
from bayes_rs.models import models_folder
from bayes_rs.records import record_store
from bayes_rs.result_folder import open_result_folder, seal_folder

PACKAGE = Path(bayes_rs.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
FORBIDDEN = {"pickle", "_pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal", "yaml", "jsonpickle"}
CALLS = {"read_pickle", "to_pickle", "eval", "exec", "compile", "literal_eval", "unsafe_load", "import_pickle"}


@pytest.mark.parametrize("module", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_package(module):
    """loky and Dask, in `fits.workers`, pickle what goes to the workers of a run, and read no file that way."""
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        assert not FORBIDDEN & {name.split(".")[0] for name in names}
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            allowed = called == "compile" and isinstance(node.func, ast.Attribute)  # re.compile
            assert allowed or called not in CALLS, ast.unparse(node)
            assert not any(keyword.arg == "allow_pickle" for keyword in node.keywords), ast.unparse(node)


@pytest.mark.parametrize(
    "error",
    [
        bayes_rs.LostResultsError("gone", damage={"a": "b"}),
        bayes_rs.NoiseMismatchError("other", difference="beam"),
        bayes_rs.NotPositiveDefiniteError("negative", smallest_eigenvalue=-1.0),
    ],
)
def test_an_error_with_data_comes_from_a_worker_as_it_was_raised(error):
    error.add_note("a note")
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own
    assert (type(again), again.args, again.__dict__) == (type(error), error.args, error.__dict__)


def test_the_check_sees_a_pickle():
    tree = ast.parse("np.load(file, allow_pickle=True)")
    assert any(
        keyword.arg == "allow_pickle"
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        for keyword in node.keywords
    )


@pytest.mark.parametrize("file", sorted(models_folder("noise").glob("*.nc")), ids=lambda path: path.name)
def test_shipped_files(file):
    """HDF5 holds numbers and texts only: no opaque and no object data."""

    def check(name, item):
        if isinstance(item, h5py.Dataset):
            assert item.dtype.kind in "fiu" or h5py.check_string_dtype(item.dtype), name

    with h5py.File(file, "r") as opened:
        opened.visititems(check)


def test_what_a_folder_fit_keeps_while_it_reads(tmp_path, monkeypatch):

    monkeypatch.setattr(record_store, "SAVE_SECONDS", 0.0)
    scan = bayes_rs.load_scan("staring")
    rows = [f"{np.datetime64('2020-01-01T00:00:00') + np.timedelta64(k, 's')},0,{k % 7}" for k in range(1500)]
    (tmp_path / "a.csv").write_text("time,beam,radial_velocity\n" + "\n".join(rows) + "\n")
    with begin_result_folder(tmp_path / "kept", key="k", key_parts={}) as folder:
        record_store.store_records(tmp_path / "a.csv", scan, folder)
    with zipfile.ZipFile(tmp_path / "kept" / "records" / "state.npz") as archive:
        for name in archive.namelist():
            with archive.open(name) as part:
                assert np.lib.format.read_array(part, allow_pickle=False).dtype.kind != "O"


def test_a_state_that_is_a_pickle_counts_as_none(tmp_path):

    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "run",))

    (tmp_path / "records").mkdir()
    np.savez(tmp_path / "records" / "state.npz", meta=np.array([Evil()], dtype=object))
    seal_folder(tmp_path)  # with a fingerprint that fits
    said = []
    assert record_store.load_state(open_result_folder(tmp_path), said.append).files == {}
    assert "and all are read again: ValueError: Object arrays cannot be loaded" in said[0]
    assert not (tmp_path / "run").exists()
