"""The public names: pinned, importable, and none of them hidden by a module of the same name."""

import importlib
import pkgutil
import subprocess
import sys

import bayes_rs

PUBLIC = [
    "along_wind_spectra",
    "average_spectra",
    "estimate_instrument_noise",
    "fit_spectra",
    "plot_spectra",
    "pool_length_scale",
    "radial_spectra",
    "with_instrument_noise",
    "with_length_scale",
    "write_report",
    "beam_mean_covariance",
    "lidar_frame_stress",
    "mean_wind",
    "pair_stresses",
    "read_motion",
    "reconstruct_pairs",
    "remove_motion",
    "wind_profile",
    "with_motion",
    "QualityRules",
    "availability_table",
    "ScanOptimum",
    "optimize_scan",
    "save_scan",
    "find_scan",
    "scan_criterion",
    "enough_beams",
    "compare",
    "prior_sensitivity",
    "directions",
    "direction_words",
    "Campaign",
    "fit_campaign",
    "run_folder_fit",
    "stream_records",
    "LongOutcome",
    "read_summary",
    "WorkerError",
    "Nuisances",
    "compare_inflow",
    "inflow_confounding",
    "inflow_in_words",
    "PulsedProbe",
    "PointProbe",
    "ContinuousWaveProbe",
    "plan",
    "Step",
    "Plan",
    "theory_bank",
    "LineMaker",
    "gap_noise",
    "FlatPrior",
    "GaussianPrior",
    "MannPrior",
    "RatioPrior",
    "SamplePrior",
    "InputError",
    "MannTurbulence",
    "MissingExtraError",
    "NoiseBank",
    "NoiseMismatchError",
    "NoiseModel",
    "NotPositiveDefiniteError",
    "Prior",
    "RecordNoise",
    "STRESSES",
    "Scan",
    "Sight",
    "WeakPrior",
    "__version__",
    "calibrate",
    "demo_file",
    "describe_report",
    "design_matrix",
    "estimate",
    "cross_spectra",
    "find_shipped_noise",
    "fit_turbulence",
    "sonic_moments",
    "velocity_covariance",
    "fit",
    "flag_words",
    "is_realizable",
    "load_noise",
    "load_scan",
    "load_turbulence",
    "make_prior",
    "make_records",
    "noise_for_records",
    "open_result",
    "pack_stress",
    "corner",
    "lumley",
    "stresses",
    "principal_variances",
    "radial_variance",
    "read",
    "read_statistics",
    "rotate_stress",
    "run_fit",
    "sight",
    "simulate",
    "summary",
    "theory_noise",
    "unpack_stress",
]


def test_the_public_names_are_these():
    assert sorted(bayes_rs.__all__) == sorted(PUBLIC)


def test_every_public_name_can_be_had():
    for name in PUBLIC:
        assert getattr(bayes_rs, name) is not None


def test_no_module_has_the_name_of_something_public():
    """Importing a module sets it on the package, where it would hide the function of that name."""
    modules = {module.name for module in pkgutil.iter_modules(bayes_rs.__path__)}
    assert modules.isdisjoint(PUBLIC)


def test_names_stay_what_they_are_when_all_modules_are_imported():
    before = {name: getattr(bayes_rs, name) for name in PUBLIC}
    for module in pkgutil.walk_packages(bayes_rs.__path__, "bayes_rs."):
        if not module.name.endswith("__main__"):  # that one runs the program
            importlib.import_module(module.name)
    assert {name: getattr(bayes_rs, name) for name in PUBLIC} == before


def test_the_command_line_does_not_load_the_science_for_its_help():
    code = (
        "import sys, bayes_rs.cli; print(sorted({'numpy', 'scipy', 'matplotlib', 'emcee', 'arviz'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603 - our own
    assert done.stdout.strip() == "[]"
