"""Scenes for tests: scans with a plain noise model, and records drawn from the model itself."""

import numpy as np
import xarray as xr

from bayes_rs import MannTurbulence, Scan
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.noise.noise import Noise

TURBULENCE = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="test")


def point_scan(directions, distance=98.0, scan_duration=1.0, times=None) -> Scan:
    """A scan of beams in these directions, shape (n_beam, 3) and any length."""
    n = len(directions)
    directions = np.asarray(directions, dtype=float)
    return Scan(
        "points",
        directions / np.linalg.norm(directions, axis=1, keepdims=True),
        focus_distance=np.broadcast_to(np.asarray(distance, dtype=float), n),
        beam_time=np.zeros(n) if times is None else times,
        scan_duration=scan_duration,
    )


def plain_noise(scan: Scan, *, relative_variance: float = 0.06, reach: float = 80.0, bias: float = -0.1) -> Noise:
    """Noise whose correlation falls exponentially with the distance of the measured points from each other."""
    across = (scan.focus_distance[:, None] * scan.line_of_sight)[:, 1:]
    distance = np.linalg.norm(across[:, None] - across[None], axis=-1)
    return Noise(
        bias=np.full(scan.n_beam, bias),
        gain=design_matrix(scan),
        covariance=relative_variance * np.exp(-distance / reach),
        beam=scan.beam,
        scan_name=scan.name,
        scan_geometry=scan.geometry(),
        wind_speed=10.0,
        yaw=scan.yaw,
        duration=600.0,
        turbulence=TURBULENCE,
        method="given",
    )


def records_of(variance: np.ndarray, scan: Scan, *, yaw_deg: float = 0.0) -> xr.Dataset:
    """Records that hold these variances, shape (n_record, n_beam)."""
    n_record = len(variance)
    return xr.Dataset(
        {
            "variance": (("record", "beam"), variance),
            "flag": (("record", "beam"), np.zeros(variance.shape, dtype=np.int64)),
            "wind_speed": ("record", np.full(n_record, 10.0)),
            "yaw": ("record", np.full(n_record, yaw_deg)),
        },
        coords={
            "beam": scan.beam,
            "time": ("record", np.datetime64("2020-01-01", "ns") + np.arange(n_record) * np.timedelta64(600, "s")),
        },
        attrs={"duration": 600.0, "scan": scan.name, "scan_key": scan.key},
    )


def draw_variances(stress: np.ndarray, scan: Scan, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """Draw log-normal variances of records with these stresses, shape (n_record, 6), straight from the definition."""
    covariance = np.log(1.0 + noise.covariance[0])
    mean = np.log(stress @ design_matrix(scan).T) - 0.5 * np.diag(covariance)
    return np.exp(mean + rng.multivariate_normal(np.zeros(scan.n_beam), covariance, len(stress), method="eigh"))
