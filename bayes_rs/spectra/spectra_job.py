"""Spectra as a job: a folder with tables and a figure, and lines that say what was found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._version import __version__
from bayes_rs.geometry.scan import Scan
from bayes_rs.output import check_output_folder, output_folder, write_csv, write_netcdf, write_run
from bayes_rs.spectra.mann_fit import fit_spectra, pool_length_scale, with_length_scale
from bayes_rs.spectra.noise_estimate import estimate_instrument_noise, with_instrument_noise
from bayes_rs.spectra.radial_spectrum import average_spectra, radial_spectra
from bayes_rs.turbulence.mann import load_turbulence

_FIT_COLUMNS = (
    "length_scale",
    "length_scale_log_sd",
    "dissipation",
    "dissipation_log_sd",
    "instrument_noise",
    "instrument_noise_sd",
    "gamma",
    "gamma_sd",
)


def run_spectra(
    series: xr.Dataset,
    records: xr.Dataset,
    scan: Scan,
    output: str | Path,
    *,
    turbulence: str = "fu-2022",
    length_scale_prior: tuple[float, float] = (60.0, 0.8),
    instrument_noise: float = 0.0,
    instrument_noise_sd: float | None = None,
    tapers: int = 0,
    one_length_scale: bool = False,
    overwrite: bool = False,
    source_files: Sequence[str] = (),
    say: Callable[[str], None] = lambda line: None,  # noqa: ARG005 - silence is the default
) -> xr.Dataset:
    """Make spectra, fit them, estimate the instrument's noise, and write what comes of it.

    Parameters
    ----------
    series, records, scan
        As in `radial_spectra`.
    output : str or Path
        Folder to make: ``spectra.csv``, the averages of each beam; ``fit.csv``, one row a record; ``noise.csv``, the
        instrument's noise of each record and beam from structure functions; ``spectra.nc`` and ``fit.nc``, all of it;
        ``records.nc``, the records with their length scales and the instrument's noise, for a fit; ``spectra.png`` and
        ``run.json``.
    turbulence : str
        Its Γ is that of the fit, and it is what the noise from structure functions takes the flow to be.
    length_scale_prior, instrument_noise, instrument_noise_sd, tapers
        As in `fit_spectra` and `radial_spectra`.
    one_length_scale : bool
        Give all records in ``records.nc`` the length scale that their spectra have in common, not each its own.
    overwrite : bool
        Replace the folder of an earlier run.
    source_files : sequence of str
        Names for ``run.json``.
    say : callable
        Takes the lines of the summary.

    Returns
    -------
    fit : xarray.Dataset
        From `fit_spectra`.

    Raises
    ------
    InputError
        If the folder exists, or input is not valid.
    """
    from bayes_rs.spectra.spectra_plot import spectra as plot  # noqa: PLC0415 - matplotlib is slow to load

    check_output_folder(output, overwrite=overwrite)
    flow = load_turbulence(turbulence)
    spectra = radial_spectra(series, scan, records, tapers=tapers)
    fit = fit_spectra(
        spectra,
        scan,
        gamma=flow.gamma,
        length_scale_prior=length_scale_prior,
        instrument_noise=instrument_noise,
        instrument_noise_sd=instrument_noise_sd,
    )
    pooled = pool_length_scale(fit)
    estimate = estimate_instrument_noise(spectra.assign(length_scale=fit["length_scale"]), scan, flow)
    averages = average_spectra(spectra)
    known = bool(np.isfinite(estimate["instrument_noise"].values).any())
    for_fit = with_length_scale(records, fit, pooled if one_length_scale else None)
    if known:
        for_fit = with_instrument_noise(for_fit, estimate)
    record = np.arange(spectra.sizes["record"])
    rows = pd.DataFrame({"record": record, "time": fit["time"].values, "wind_speed": spectra["wind_speed"].values})
    rows = rows.assign(**{name: fit[name].values for name in _FIT_COLUMNS})
    floor = estimate.drop_vars("time").assign_coords(record=record).to_dataframe().reset_index()
    with output_folder(output, overwrite=overwrite) as folder:
        write_csv(averages.to_dataframe().reset_index(), folder / "spectra.csv", index=False)
        write_csv(rows, folder / "fit.csv", index=False)
        write_csv(floor, folder / "noise.csv", index=False)
        write_netcdf(spectra, folder / "spectra.nc")
        write_netcdf(fit, folder / "fit.nc")
        write_netcdf(for_fit, folder / "records.nc")
        plot(spectra, fit).savefig(folder / "spectra.png", dpi=130)
        write_run(
            folder,
            {
                "bayes_rs": __version__,
                "command": "spectra",
                "scan": scan.name,
                "scan_key": scan.key,
                "source_files": list(source_files),
                "turbulence": turbulence,
                "length_scale_prior": list(length_scale_prior),
                "instrument_noise": instrument_noise,
                "instrument_noise_sd": instrument_noise_sd,
                "tapers": tapers,
                "one_length_scale": one_length_scale,
                "interval": spectra.attrs["interval"],
                "n_record": len(record),
                "n_fitted": int(np.isfinite(rows["length_scale"]).sum()),
                "length_scale_of_all": float(pooled["length_scale"].values[0]),
                "length_scale_of_all_log_sd": float(pooled["length_scale_log_sd"].values[0]),
            },
        )
    for line in spectra_words(fit, pooled, estimate):
        say(line)
    scale = "the length scale of all" if one_length_scale else "its own length scale"
    say(f"records.nc: each record with {scale}, for bayes-rs fit")
    if known:
        say("  and with the instrument's noise, which is taken off there")
    return fit


def spectra_words(fit: xr.Dataset, pooled: xr.Dataset, estimate: xr.Dataset) -> list[str]:
    """Say what was found.

    Parameters
    ----------
    fit, pooled, estimate : xarray.Dataset
        From `fit_spectra`, `pool_length_scale` and `estimate_instrument_noise`.

    Returns
    -------
    lines : list of str
        Length scale, noise by both ways, and flags.
    """
    scale, width = fit["length_scale"].values, fit["length_scale_log_sd"].values
    known = np.isfinite(scale)
    low, middle, high = np.quantile(scale[known], [0.05, 0.5, 0.95])
    both = fit["instrument_noise"].values[known], fit["instrument_noise_sd"].values[known]
    noise, sd = estimate["instrument_noise"].values, estimate["instrument_noise_sd"].values
    above = int(np.count_nonzero(estimate["flag"].values & 1))
    unsure = int(np.count_nonzero(estimate["flag"].values & 4))
    each = f"a factor {np.exp(np.median(width[known])):.2g} (one standard deviation)"
    factor = float(np.exp(pooled["length_scale_log_sd"].values[0]))
    floor, floor_sd = float(both[0].mean()), float(np.median(both[1]))
    common = f"{pooled['length_scale'].values[0]:.3g} m within a factor {factor:.3g}"
    lines = [
        f"{int(known.sum())} of {len(scale)} records fitted",
        f"length scale: median {middle:.3g} m, 5 to 95 % of the records {low:.3g} to {high:.3g} m",
        f"  each is known within {each}; one for all records: {common}",
        f"instrument noise, floor of the spectrum: mean {floor:.3g} m² s⁻², each record ± {floor_sd:.2g}",
    ]
    if np.isfinite(noise).any():
        lines.append(
            f"  structure function: mean {np.nanmean(noise):.3g} m² s⁻², each record and beam ± {np.nanmedian(sd):.2g}"
            + (f"; {unsure} of {int(np.isfinite(noise).sum())} are not identified" if unsure else "")
        )
    if above:
        lines.append(f"flag above_variance: the noise of {above} beams of records is not below their variance")
    return lines
