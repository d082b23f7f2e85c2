"""The command that makes spectra, and spectra of measured data."""

import json

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import bayes_rs as brs
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
    names = {"spectra.csv", "fit.csv", "noise.csv", "spectra.nc", "fit.nc", "spectra.png", "run.json"}
    assert {file.name for file in (tmp_path / "out").iterdir()} == names
    table = pd.read_csv(tmp_path / "out" / "fit.csv")
    assert len(table) == 5
    assert table["length_scale"].between(10.0, 400.0).all()
    assert json.loads((tmp_path / "out" / "run.json").read_text())["n_fitted"] == 5
    assert len(pd.read_csv(tmp_path / "out" / "noise.csv")) == 10
    again = CliRunner().invoke(spectra, arguments)
    assert isinstance(again.exception, brs.InputError)


def test_the_measured_day(iea_folder):
    scan = brs.load_scan("pulsed-4-beam")
    series = brs.read_radial_velocity(sorted(iea_folder.glob("Lidar_*_LOS?_178m.csv")), scan)
    records = brs.make_records(series, scan)
    day = brs.radial_spectra(series, scan, records)
    assert day.attrs["interval"] == pytest.approx(4.0, rel=0.01)
    both = records["flag"].values == 0
    assert day["variance"].values[both] == pytest.approx(records["variance"].values[both], rel=1e-3)
    fit = brs.fit_spectra(day, scan, show_progress=False)
    assert np.isfinite(fit["length_scale"].values).sum() >= 140
    pooled = brs.pool_length_scale(fit)
    assert 15.0 < float(pooled["length_scale"][0]) < 400.0
    # a pulsed lidar's gate takes what is high in frequency: the averaged spectrum falls in the upper decade
    averages = brs.average_spectra(day)
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
    hour = brs.radial_spectra(series, scan, records)
    assert hour.attrs["interval"] == pytest.approx(30.2, rel=0.02)
    assert float(hour["timing_spread"].max()) < 0.25
    fit = brs.fit_spectra(hour, scan, show_progress=False)
    # twenty samples, 30 s apart: every record says little more than the prior, whose width is 0.8
    assert np.nanmin(fit["length_scale_log_sd"].values) > 0.3
    found = brs.estimate_instrument_noise(hour, scan, brs.load_turbulence("fu-2022"))
    assert np.mean(found["flag"].values[np.isfinite(found["instrument_noise"].values)] & 4 > 0) > 0.5
