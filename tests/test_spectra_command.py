"""The command that makes spectra, and spectra of measured data."""

import json

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import bayes_rs as brs
from bayes_rs.cli.fit_commands import fit
from bayes_rs.cli.spectra_command import spectra
from bayes_rs.readers.rays import direction_of


def test_the_command_writes_tables_a_figure_and_what_it_did(tmp_path):
    scan = brs.load_scan("2-beam")
    series = brs.simulate(scan, brs.load_turbulence("fu-2022"), wind_speed=10.0, n_records=5, seed=1)
    series.to_dataframe().reset_index(drop=False)[["time", "beam", "radial_velocity"]].to_csv(
        tmp_path / "day.csv", index=False
    )
    arguments = [
        str(tmp_path / "day.csv"),
        "--scan",
        "2-beam",
        "--positive",
        "away",
        "-o",
        str(tmp_path / "out"),
    ]
    done = CliRunner().invoke(spectra, arguments)
    assert done.exit_code == 0, done.output
    assert "5 of 5 records fitted" in done.output
    names = {"spectra.csv", "fit.csv", "noise.csv", "spectra.nc", "fit.nc", "records.nc", "spectra.png", "run.json"}
    names.add("fingerprints.jsonl")
    assert {file.name for file in (tmp_path / "out").iterdir()} == names
    table = pd.read_csv(tmp_path / "out" / "fit.csv")
    assert len(table) == 5
    assert table["length_scale"].between(10.0, 400.0).all()
    assert json.loads((tmp_path / "out" / "run.json").read_text())["n_fitted"] == 5
    assert len(pd.read_csv(tmp_path / "out" / "noise.csv")) == 10
    again = CliRunner().invoke(spectra, arguments)
    assert isinstance(again.exception, brs.InputError)


ADDED = 0.3
"""Variance of the instrument noise in the file below, m² s⁻²."""


@pytest.fixture(scope="module")
def noisy_day(tmp_path_factory):
    flow = brs.load_turbulence("stable-offshore")  # L is 16 m, the fit's own 61 m
    series = brs.simulate("2-beam", flow, wind_speed=10.0, n_records=20, seed=1)
    noise = np.random.default_rng(2).normal(0.0, np.sqrt(ADDED), series.sizes["sample"])
    series["radial_velocity"] = series["radial_velocity"] + noise
    table = series.to_dataframe().reset_index(drop=False)[["time", "beam", "radial_velocity"]]
    file = tmp_path_factory.mktemp("noisy") / "day.csv"
    table.to_csv(file, index=False)
    return file


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("common", [False, True])
def test_its_records_go_into_a_fit(noisy_day, tmp_path, common):
    """Noise that was added is found, and taken away; the noise of the records is that of their length scale."""
    arguments = [str(noisy_day), "--scan", "2-beam", "--positive", "away", "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(spectra, [*arguments, *(["--one-length-scale"] if common else [])])
    assert done.exit_code == 0, done.output
    assert f"each record with {'the length scale of all' if common else 'its own length scale'}" in done.output
    records = xr.load_dataset(tmp_path / "out" / "records.nc", engine="h5netcdf")
    own = pd.read_csv(tmp_path / "out" / "fit.csv")["length_scale"]
    pooled = json.loads((tmp_path / "out" / "run.json").read_text())["length_scale_of_all"]
    expected = np.full(20, pooled) if common else own.to_numpy()
    np.testing.assert_allclose(records["length_scale"], expected, rtol=1e-12)
    assert 10.0 < pooled < 25.0
    found = np.unique(records["instrument_noise"].values)
    assert found == pytest.approx([ADDED], abs=0.045)  # five of its standard deviations, as with_instrument_noise says
    uu = {}
    for name, more in (("with", ["--instrument-noise", "records"]), ("without", ["--instrument-noise", "0"])):
        target = tmp_path / name
        given = [str(tmp_path / "out" / "records.nc"), "--scan", "2-beam", "--sampler", "direct", "--ess", "200"]
        given += ["--draws", "none"]
        done = CliRunner().invoke(fit, [*given, *more, "-o", str(target)])
        assert done.exit_code == 0, done.output
        rows = pd.read_csv(target / "summary.csv")
        uu[name] = float(rows[rows["stress"] == "uu"]["median"].mean())
        run = json.loads((target / "run.json").read_text())
        scales = run["noise"]["length_scales"]
        assert scales[0] <= expected.min() * (1.0 + 1e-6)
        assert scales[-1] >= expected.max() * (1.0 - 1e-6)
    lost = found[0] / np.cos(np.deg2rad(15.0)) ** 2
    # a tenth: what vv takes of it and medians of skewed posteriors; it came out 1 to 2 % below
    assert uu["without"] - uu["with"] == pytest.approx(lost, rel=0.1)


def test_the_measured_day(iea_folder):
    scan = brs.load_scan("pulsed-4-beam")
    series = brs.read(sorted(iea_folder.glob("Lidar_*_LOS?_178m.csv")), scan)
    records = brs.make_records(series, scan)
    day = brs.spectra.radial_spectra(series, scan, records)
    assert day.attrs["interval"] == pytest.approx(4.0, rel=0.01)
    both = records["flag"].values == 0
    assert day["variance"].values[both] == pytest.approx(records["variance"].values[both], rel=1e-3)
    fit = brs.spectra.fit_spectra(day, scan)
    assert np.isfinite(fit["length_scale"].values).sum() >= 140
    pooled = brs.spectra.pool_length_scale(fit)
    assert 15.0 < float(pooled["length_scale"][0]) < 400.0
    # a pulsed lidar's gate takes what is high in frequency: the averaged spectrum falls in the upper decade
    averages = brs.spectra.average_spectra(day)
    slope = np.polyfit(np.log(averages["frequency"][-8:]), np.log(averages["spectrum"].values[:, -8:]).T, 1)[0]
    assert np.all((slope < -0.8) & (slope > -3.0))


def test_the_measured_hour(six_beam_hour):
    measured = xr.open_dataset(six_beam_hour)
    azimuth, elevation = measured["azimuth"].values.astype(float) % 360.0, measured["elevation"].values.astype(float)
    number = np.where(elevation > 85.0, 5, np.round(azimuth / 72.0).astype(int) % 5)
    azimuths = np.array([0.0, 72.0, 144.0, 216.0, 288.0, 0.0])
    scan = brs.Scan(
        "six-beam hour",
        direction_of(azimuths, np.array([75.0] * 5 + [90.0])),
        focus_distance=np.full(6, 208.0),
        beam_time=5.0 * np.arange(6),
        scan_duration=30.2,
    )
    gate = 3
    good = measured["radial_wind_speed_status"].values[:, gate] == 1
    series = xr.Dataset(
        {"radial_velocity": ("sample", measured["radial_wind_speed"].values[good, gate].astype(float))},
        coords={"time": ("sample", measured["time"].values[good]), "beam": ("sample", number[good])},
    )
    records = brs.make_records(series, scan, min_availability=0.5)
    hour = brs.spectra.radial_spectra(series, scan, records)
    assert hour.attrs["interval"] == pytest.approx(30.2, rel=0.02)
    assert float(hour["timing_spread"].max()) < 0.25
    fit = brs.spectra.fit_spectra(hour, scan)
    # twenty samples, 30 s apart: every record says little more than the prior, whose width is 0.8
    assert np.nanmin(fit["length_scale_log_sd"].values) > 0.3
    found = brs.spectra.estimate_instrument_noise(hour, scan, brs.load_turbulence("fu-2022"))
    assert np.mean(found["flag"].values[np.isfinite(found["instrument_noise"].values)] & 4 > 0) > 0.5
