"""What numbers may be: the limits of every quantity by its name, once for command line, settings files and Python."""

from __future__ import annotations

from math import pi
from typing import NamedTuple

DAY = 86_400.0
"""Seconds of a day."""


class Limits(NamedTuple):
    """The least and the most that a quantity may be.

    Attributes
    ----------
    least, most : float
        Both ends may be taken. A quantity that may be zero, too, is checked for that by its own rule.
    usual : str
        What is usual, for the message; empty if there is no such thing.
    """

    least: float
    most: float
    usual: str = ""


_ANGLE_DEG = Limits(-360.0, 360.0, "-180 to 180 are usual")
_RADIANS = "it is in radians: np.deg2rad makes them of degrees"
_LENGTH = Limits(1e-9, 1e6)
_LOG_SD = Limits(1e-6, 3.0, "0.1 to 1 are usual")
_SD_DEG = Limits(1e-6, 180.0, "1 to 5 are usual")
_VARIANCE = Limits(1e-12, 1e3, "0.001 to 0.1 are usual")
_DECIBEL = Limits(-1e3, 1e3)
_COUNT = Limits(0, 10**9)

MOST_WIND = 90.0
"""m/s; faster than any wind near the ground, and slower than the numbers that mark a missing entry, from 99 on."""
LIMITS: dict[str, Limits] = {
    # times, s
    "duration": Limits(1e-2, 31 * DAY, "600 is usual"),
    "scan_duration": Limits(1e-9, 1e6, "1 to 20 are usual"),
    "dwell": Limits(1e-9, 1e6, "0.01 to 5 are usual"),
    "sample_duration": Limits(1e-9, 1e6, "0.01 to 5 are usual"),
    "beam_time": Limits(0.0, 1e6),
    "period": Limits(1e-2, 31 * DAY),
    "lateness": Limits(1e-9, 366 * DAY),
    "max_gap": Limits(1e-9, 366 * DAY),
    "time_offset": Limits(-366 * DAY, 366 * DAY),
    # flow
    "wind_speed": Limits(1e-3, MOST_WIND, "3 to 25 are usual"),
    "min_wind_speed": Limits(1e-6, MOST_WIND, "1 to 5 are usual"),
    "velocity_limit": Limits(1e-3, 1e6, "90 is usual"),
    "hard_target_speed": Limits(1e-6, 200.0, "0.5 is usual"),
    "length_scale": Limits(1e-2, 1e5, "30 to 100 are usual"),
    "dissipation": Limits(1e-12, 1e8, "0.01 to 0.3 are usual"),
    "gamma": Limits(0.0, 15.0, "2 to 5 are usual; above 15 the Mann model has no data behind it"),
    "gamma_low": Limits(0.0, 15.0),
    "gamma_high": Limits(0.0, 15.0),
    "shear": Limits(-10.0, 10.0, "0 to 0.1 are usual"),
    "instrument_noise": _VARIANCE,
    "instrument_noise_sd": _VARIANCE,
    "length_scale_prior": Limits(1e-3, 1e5, "60 m and 0.8 are usual"),
    # geometry, m, degrees and rad
    "focus_distance": _LENGTH,
    "distance": _LENGTH,
    "range": _LENGTH,
    "height": _LENGTH,
    "separation": Limits(-1e18, 1e18),
    "position": Limits(-1e6, 1e6),
    "rotor_radius": _LENGTH,
    "range_tolerance": _LENGTH,
    "hub_height": Limits(1e-2, 1e5, "50 to 150 are usual"),
    "reference_height": Limits(1e-2, 1e5),
    "wavelength": Limits(1e-9, 1.0, "1.5e-6 is usual"),
    "aperture_radius": Limits(1e-6, 1e3, "0.03 is usual"),
    "rayleigh_length": Limits(1e-18, 1e6, "1 to 10 are usual"),
    "gate_length": Limits(1e-18, 1e6, "20 to 60 are usual"),
    "pulse_length": Limits(1e-18, 1e6, "20 to 60 are usual"),
    "spacing": Limits(1e-3, 1e6),
    "record_length": Limits(1e-3, 1e9),
    "tilt": Limits(-0.5 * pi, 0.5 * pi, _RADIANS),
    "yaw": Limits(-2.0 * pi, 2.0 * pi, _RADIANS),
    "wind_yaw": Limits(-4.0 * pi, 4.0 * pi, _RADIANS),  # of records, which may count on to two turns
    "tilt_deg": Limits(-90.0, 90.0, "-10 to 10 are usual"),
    "yaw_deg": _ANGLE_DEG,
    "heading_deg": _ANGLE_DEG,
    "phase_zero_deg": _ANGLE_DEG,
    "min_elevation_deg": Limits(-90.0, 90.0),
    "min_spread_deg": Limits(1e-9, 180.0),
    "angle_tolerance_deg": Limits(1e-6, 180.0, "1 is usual"),
    "tolerance_deg": Limits(1e-6, 180.0),
    # signals
    "hard_target_cnr": _DECIBEL,
    "blade_frequency": Limits(1e-9, 1e6),
    "beam_sd": Limits(1e-9, 1e3),
    # what is uncertain
    "yaw_sd_deg": _SD_DEG,
    "yaw_sd_missing_deg": _SD_DEG,
    "tilt_sd_deg": _SD_DEG,
    "instrument_noise_log_sd": _LOG_SD,
    "probe_length_log_sd": _LOG_SD,
    "length_scale_log_sd": Limits(1e-6, 2.0, "0.1 to 1 are usual"),
    "vertical_gradient_sd": Limits(1e-9, 5.0, "0.3 is usual"),
    "lateral_gradient_sd": Limits(1e-9, 5.0, "0.3 is usual"),
    "inflation": Limits(1e-3, 1e3, "1 to 3 are usual"),
    "factor": Limits(1e-3, 1e3, "0.5 and 2 are usual"),
    "prob": Limits(1e-6, 1.0 - 1e-6, "0.9 is usual"),
    "bound": Limits(1e-12, 1e6, "20 is usual"),
    # counts
    "n_beams": Limits(1, 10_000),
    "target_ess": Limits(1, 10**5, "1000 is usual"),
    "max_extension": Limits(0, 16, "5 is usual"),
    "monte_carlo_error": Limits(1e-3, 1.0, "0.02 to 0.05 are usual"),
    "despike_window": Limits(3, 1001, "11 is usual"),
    "blade_window": Limits(3, 1001, "11 is usual"),
    "sub_records": Limits(4, 1000, "6 is usual"),
    "workers": Limits(1, 1024),
    "tapers": Limits(0, 1000, "0 to 10 are usual"),
    "n_starts": Limits(1, 10**6, "24 is usual"),
}
"""Limits by name, in the unit of the quantity."""

OF_SIZE = Limits(1e-12, 1e12)
"""Of quantities above zero, or not below it, that have no limits of their own."""
OF_COUNT = _COUNT
"""Of whole numbers that have none."""
MOST_SEED = 2**63
"""Seeds are below it: every generator takes them, and every file holds them."""
