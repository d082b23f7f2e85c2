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
    "plot_trade_off",
    "trade_off",
    "compare",
    "plot_comparison",
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
    "LineMaker",
    "FlatPrior",
    "GaussianPrior",
    "MannPrior",
    "RatioPrior",
    "SamplePrior",
    "InputError",
    "MannTurbulence",
    "MissingExtraError",
    "NoiseMismatchError",
    "Noise",
    "noise",
    "turbulence",
    "NotPositiveDefiniteError",
    "Prior",
    "STRESSES",
    "Scan",
    "Sight",
    "WeakPrior",
    "__version__",
    "autocorrelation_time",
    "demo_file",
    "describe_report",
    "design_matrix",
    "ess_bulk",
    "ess_tail",
    "estimate",
    "cross_spectra",
    "fit_turbulence",
    "velocity_covariance",
    "fit",
    "flag_words",
    "is_realizable",
    "load_scan",
    "load_turbulence",
    "make_prior",
    "make_records",
    "open_result",
    "pack_stress",
    "plot_corner",
    "plot_lumley",
    "plot_stresses",
    "principal_variances",
    "r_hat",
    "radial_variance",
    "read_radial_velocity",
    "stream_radial_velocity",
    "read_statistics",
    "rotate_stress",
    "run_fit",
    "sight",
    "simulate",
    "summary",
    "unpack_stress",
]


def test_the_public_names_are_these():
    assert sorted(bayes_rs.__all__) == sorted(PUBLIC)


def test_every_public_name_can_be_had():
    for name in PUBLIC:
        assert getattr(bayes_rs, name) is not None


def test_the_names_of_noise_and_turbulence():
    assert sorted(bayes_rs.noise.__all__) == [
        "Boxes",
        "Noise",
        "RecordNoise",
        "SonicMoments",
        "SonicNoise",
        "calibrate",
        "load",
        "sonic_moments",
        "theory",
    ]
    assert sorted(bayes_rs.turbulence.__all__) == [
        "MannTurbulence",
        "cross_spectra",
        "fit",
        "load",
        "velocity_covariance",
    ]
    for package in (bayes_rs.noise, bayes_rs.turbulence):
        assert all(callable(getattr(package, name)) for name in package.__all__)


def test_no_module_has_the_name_of_something_public():
    """Importing a module sets it on the package, where it would hide the function of that name."""
    for package, subjects in (
        (bayes_rs, {"noise", "turbulence"}),
        (bayes_rs.noise, set()),
        (bayes_rs.turbulence, set()),
    ):
        modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
        assert modules.isdisjoint(set(package.__all__) - subjects)


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
