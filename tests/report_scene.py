"""Folders of fits for the tests of the report: with and without draws, with records that failed and without."""

import json
import shutil
from pathlib import Path

import xarray as xr
from fit_scene import OPTIONS, SCAN, fit_to, make_records

import bayes_rs as brs
from bayes_rs import demo_file, fit, load_scan, read
from bayes_rs.result_folder import seal_folder

EVIL = "<script>document.title = 'broken'</script>\"'&.csv"


def demo_records():
    """The six records of the demo's six beams, the third without a beam, the fifth with one beam less."""
    scan = load_scan("6-beam")
    records = brs.make_records(read(demo_file("6-beam"), scan), scan)
    records["flag"].values[2] = 1
    records["flag"].values[4, 3] = 1
    return records, scan


def result_folder(folder, *, n_record=6, flagged=False, timed=True):
    """A folder with all draws."""
    records, scan = demo_records()
    records = records.isel(record=slice(0, n_record))
    if flagged:
        records["flag"].values[:] = 1
    if not timed:
        records = records.drop_vars("time")
    fit(records, scan, output=folder, seed=1, target_ess=200)
    return Path(folder)


def evil_folder(folder, source):
    """A copy of a folder whose texts try to run as a script and to break out of their places."""
    path = Path(shutil.copytree(source, folder))
    run = json.loads((path / "run.json").read_text())
    run.update({"source_files": [EVIL], "scan": EVIL, "</script>{{data}}": "</td><img src=x onerror=alert(1)>"})
    (path / "run.json").write_text(json.dumps(run))
    records = xr.load_dataset(path / "records.nc", engine="h5netcdf")
    report = json.loads(records.attrs["read_report"])
    report["files"][0]["name"] = EVIL
    records.attrs["read_report"] = json.dumps(report)
    (path / "records.nc").unlink()
    records.to_netcdf(path / "records.nc", engine="h5netcdf")
    seal_folder(path)  # as if our own run had written all this
    return path


def table_folder(folder, *, draws="none", n_record=23):
    """A folder of tables: 23 records, seven of them not fitted."""
    return Path(fit_to(make_records(n_record), SCAN, folder, draws=draws, **OPTIONS).place)
