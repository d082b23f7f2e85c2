"""What the jobs that fit are asked for, checked before any work is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_rs.fits.job_noise import about_probe, noise_of_job
from bayes_rs.fits.plan import CampaignOptions
from bayes_rs.fits.record_yaw import with_yaw_sd
from bayes_rs.geometry.scan import Scan
from bayes_rs.noise.file import load_noise
from bayes_rs.noise.noise import Noise


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """Which noise, and which fit; the arguments are those of `run_fit` and `fit_campaign`.

    Raises
    ------
    InputError
        If an option of the fit is not valid, when it is made.
    """

    noise_file: str | Path | None
    turbulence: str
    noise_method: str
    of_fit: CampaignOptions

    def given_noise(self) -> Noise | None:
        """Read the noise from its file; None if it is to be made for the records."""
        return None if self.noise_file is None else load_noise(self.noise_file)

    def noise_and_records(
        self, records: xr.Dataset, scan: Scan, given: Noise | None, say: Callable[[str], None]
    ) -> tuple[Noise, xr.Dataset]:
        """Return the noise, given or made for the records, and records that hold all that the fit asks of them."""
        nuisances = self.of_fit.nuisances
        noise = noise_of_job(
            records,
            scan,
            given=given,
            turbulence=self.turbulence,
            method=self.noise_method,
            sonic=self.of_fit.target == "sonic",
            nuisances=nuisances,
            say=say,
        )
        return noise, with_yaw_sd(records, scan, noise, nuisances, say)

    def for_key(self, given: Noise | None) -> dict[str, Any]:
        """Return what tells runs with other options apart, by name, for `digest_parts`."""
        made = {"turbulence": self.turbulence, "noise_method": self.noise_method}
        return {**made, "noise": given, **self.of_fit.for_key()}

    def for_run(self, noise: Noise, records: xr.Dataset) -> dict[str, Any]:
        """Return what `run.json` says of where the noise came from."""
        made = {"noise_turbulence": self.turbulence, "noise_method": self.noise_method}
        read = {} if self.noise_file is None else {"noise_file": Path(self.noise_file).name}
        return {**(read or made), "probe_volume": about_probe(noise, records)}
