"""A value of every option of the settings that is not its default: on the command line, and as Python has it."""

from typing import NamedTuple

from bayes_rs.fits.settings import SECTIONS
from bayes_rs.options import Option, options_of
from bayes_rs.posteriors.nuisance import Nuisances


class Sample(NamedTuple):
    """A value, what gives it on the command line, and what it needs beside it."""

    value: object
    words: tuple[str, ...] = ()
    needs: dict[str, object] = {}  # noqa: RUF012 - never changed


def one(flag, value, **needs):
    return Sample(value, (flag, str(value)), needs)


SAMPLES = {
    "scan": {
        "scan": one("--scan", "50-beam"),
        "opening_angle_deg": one("--opening-angle", 40.0),
        "focus_distance": Sample((50.0, 90.0), ("--focus-distance", "50", "--focus-distance", "90")),
        "tilt_deg": one("--tilt", 2.5),
        "yaw_deg": one("--yaw", -4.0),
        "scan_group": Sample(2, ("--scan-group", "2"), {"scan": "auto"}),
        "scan_toml": Sample("title = 'mine'"),
    },
    "files": {
        "files": Sample(("/data/day.csv",)),
        "file_format": one("--format", "long"),
        "columns": Sample({"radial_velocity": "RWS"}, ("--column", "radial_velocity=RWS")),
        "beam_numbers": Sample({"LOS2": 2, "LOS3": 3}, ("--beam-number", "LOS2=2", "--beam-number", "LOS3=3")),
        "positive": one("--positive", "towards"),
        "velocity_unit": one("--velocity-unit", "km/h"),
        "invalid": Sample((9999.0, -999.0), ("--invalid", "9999", "--invalid", "-999")),
        "velocity_limit": one("--velocity-limit", 120.0),
        "time_zone": one("--time-zone", "UTC+1"),
        "time_format": one("--time-format", "unix"),
        "time_stamp": one("--time-stamp", "middle"),
        "sample_duration": one("--sample-duration", 0.5),
        "separator": one("--separator", ";"),
        "decimal": one("--decimal", ","),
        "skip_rows": one("--skip-rows", 2),
        "comment": one("--comment", "#"),
        "encoding": one("--encoding", "cp1252"),
        "status_valid": one("--status-valid", 1.0),
        "angle_tolerance_deg": one("--angle-tolerance", 2.0),
        "range_tolerance": one("--range-tolerance", 3.0),
        "gate_length": one("--gate-length", 30.0),
        "range": Sample((80.0, 120.0), ("--range", "80,120")),
        "height": Sample((40.0, 60.0, 80.5), ("--height", "40,60,80.5")),
        "gates_by": one("--gates-by", "height"),
        "phase_zero_deg": one("--phase-zero", 90.0),
        "phase_turns": one("--phase-turns", "down"),
        "out_of_order": one("--out-of-order", "sort"),
        "bad_rows": one("--bad-rows", "drop"),
        "on_bad_file": one("--on-bad-file", "error"),
    },
    "records": {
        "duration": one("--duration", 300.0),
        "min_availability": one("--min-availability", 0.5),
        "expected_count": Sample(480.0),
        "min_count": Sample(20),
        "correlations": Sample(True, ("--correlations",)),
        "motion": Sample(("/data/a.csv", "/data/b.csv"), ("--motion", "/data/a.csv", "--motion", "/data/b.csv")),
        "motion_columns": Sample(
            {"tilt_deg": "Tilt"}, ("--motion-column", "tilt_deg=Tilt"), {"motion": ("/data/a.csv",)}
        ),
        "mast": Sample(("/data/m.csv",), ("--mast", "/data/m.csv"), {"mast_position": (-98.0, 0.0, 2.0)}),
        "mast_position": Sample(
            (-200.0, 0.5, 10.0), ("--mast-position", "-200", "0.5", "10"), {"mast": ("/data/m.csv",)}
        ),
    },
    "quality": {
        "status_valid": Sample((1.0, 2.0)),
        "status_reject_bits": Sample(3),
        "masks": Sample(("rain",)),
        "cnr_range": Sample((-23.0, 0.0), ("--cnr-range", "-23", "0")),
        "snr_range": Sample({0: (-23.0, 0.0)}),
        "velocity_range": Sample((-30.0, 5.0), ("--velocity-range", "-30", "5")),
        "hard_target_cnr": one("--hard-target-cnr", -5.0),
        "hard_target_speed": Sample(0.7, (), {"hard_target_cnr": -5.0}),
        "blocked_sectors": Sample({"rotor_angle": ((350.0, 10.0),)}),
        "frozen_run": one("--frozen-run", 5),
        "blade_threshold": one("--blade-threshold", 6.0),
        "blade_window": Sample(13, (), {"blade_threshold": 6.0}),
        "blade_frequency": Sample((0.3, 1.2), ("--blade-frequency", "0.3", "1.2")),
        "despike": one("--despike", "median"),
        "despike_window": Sample(15, (), {"despike": "median"}),
        "despike_threshold": Sample(6.0, (), {"despike": "median"}),
        "wind_sectors": Sample({2: ((10.0, 30.0),)}),
        "sub_records": Sample(8, (), {"trend_level": 0.01}),
        "trend_level": one("--trend-level", 0.01),
        "sub_variance_limit": one("--sub-variance-limit", 0.3),
        "half_ratio_limit": one("--half-ratio-limit", 4.0),
        "min_wind_speed": one("--min-wind-speed", 3.0),
        "exclude": Sample(
            ("low_wind", "not_stationary"),
            ("--exclude", "low_wind", "--exclude", "not_stationary"),
            {"min_wind_speed": 3.0, "trend_level": 0.01},
        ),
    },
    "noise": {
        "noise": one("--noise", "/data/noise.nc"),
        "turbulence": one("--turbulence", "iec-a"),
    },
    "fit": {
        "seed": one("--seed", 7),
        "prior": one("--prior", "flat:bound=10"),
        "target": one("--target", "ensemble"),
        "sampler": one("--sampler", "direct"),
        "likelihood": Sample("mine"),  # a likelihood of the user's own, which the tests register
        "information": one("--information", "covariances"),
        "coherence_log_sd": one("--coherence-log-sd", 0.2),
        "mast_log_sd": one("--mast-log-sd", 0.3),
        "target_ess": one("--ess", 150),
        "max_extension": one("--max-extension", 3),
        "monte_carlo_error": one("--monte-carlo-error", 0.04),
        "instrument_noise": one("--instrument-noise", 0.02),
        "nuisances": Sample(Nuisances(inflation=1.5)),
        "prob": one("--prob", 0.5),
        "interval": one("--interval", "highest-density"),
        "derived": Sample(("tke", "ti"), ("--derived", "tke", "--derived", "ti")),
        "draws": one("--draws", "float32"),
        "scatter": one("--scatter", "theory"),
        "unsteady_level": one("--unsteady-level", 0.05),
        "campaign": Sample("off", ("--no-campaign",)),
        "campaign_group": one("--campaign-group", "hour"),
        "campaign_unsteady": Sample(True, ("--campaign-unsteady",)),
    },
    "nuisances": {
        "yaw_sd_deg": one("--yaw-sd", 2.0),
        "yaw_sd_missing_deg": one("--yaw-sd-missing", 3.0, yaw_sd_deg="records"),
        "tilt_sd_deg": one("--tilt-sd", 0.5),
        "instrument_noise_log_sd": one("--instrument-noise-sd", 0.3, instrument_noise=0.05),
        "length_scale_log_sd": one("--length-scale-sd", 0.4),
        "length_scale": one("--length-scale", 80.0, length_scale_log_sd=0.2),
        "probe_length_log_sd": one("--probe-length-sd", 0.2),
        "vertical_gradient_sd": one("--vertical-gradient-sd", 0.3),
        "lateral_gradient_sd": one("--lateral-gradient-sd", 0.2),
        "inflation": one("--inflation", 1.3),
        "inflation_dof": one("--inflation-dof", 9.0),
    },
    "output": {
        "output": one("--output", "/data/out"),
        "overwrite": Sample(True, ("--overwrite",)),
        "resume": Sample(True, ("--resume",)),
        "workers": one("--workers", 3),
        "scheduler": one("--scheduler", "tcp://10.0.0.1:8786"),
    },
}
"""By section (nuisances are one here) and option. An option without a sample fails the tests."""

CLASSES = {**SECTIONS, "nuisances": Nuisances}
EVERY = [(section, entry.name) for section, cls in CLASSES.items() for entry in options_of(cls)]
"""Every option, as (section, name)."""


def entry_of(section: str, name: str) -> Option:
    return next(entry for entry in options_of(CLASSES[section]) if entry.name == name)


def words_of_needs(needs: dict[str, object]) -> list[str]:
    """Return the words of a command line for what a sample needs."""
    words: list[str] = []
    for name, value in needs.items():
        entry = entry_of(next(place for place, option in EVERY if option == name), name)
        if isinstance(value, tuple) and "tuple" in str(entry.type):  # so many numbers, and not a list
            words += [entry.flag, *map(str, value)]
            continue
        for part in value if isinstance(value, tuple) else (value,):
            words += [entry.flag, str(part)]
    return words


def value_of(settings, section, name):
    """Return an option of settings."""
    return getattr(settings.fit.nuisances if section == "nuisances" else getattr(settings, section), name)


def changed(settings, section, sample, name):
    """Return settings with the sample, also of an option whose name two sections have."""
    from dataclasses import replace  # noqa: PLC0415 - beside its use

    beside = {one: value for one, value in sample.needs.items() if section != "nuisances" and one in SAMPLES[section]}
    settings = settings.changed(**{one: value for one, value in sample.needs.items() if one not in beside})
    if section == "nuisances":
        own = replace(settings.fit.nuisances, **{name: sample.value})
        return replace(settings, fit=replace(settings.fit, nuisances=own))
    return replace(settings, **{section: replace(getattr(settings, section), **{**beside, name: sample.value})})
