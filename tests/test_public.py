"""The public names: pinned, importable, and none of them hidden by a module of the same name."""

import importlib
import inspect
import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest

import bayes_rs

PUBLIC = [
    "Fit",
    "FitOptions",
    "InputError",
    "LostResultsError",
    "MannTurbulence",
    "MissingExtraError",
    "Noise",
    "NoiseMismatchError",
    "NotPositiveDefiniteError",
    "Nuisances",
    "Prior",
    "QualityRules",
    "RangedFit",
    "STRESSES",
    "Scan",
    "Settings",
    "Stream",
    "WorkerError",
    "__version__",
    "budget",
    "campaign",
    "compare",
    "compare_inflow",
    "demo_file",
    "design",
    "estimate",
    "export_boxes",
    "find_scan",
    "fit",
    "fit_files",
    "geometry",
    "inflow_confounding",
    "load_scan",
    "load_turbulence",
    "make_records",
    "noise",
    "open_fit",
    "optimize_scan",
    "plan",
    "plot",
    "prior_sensitivity",
    "priors",
    "quality",
    "read",
    "readers",
    "records",
    "save_scan",
    "simulate",
    "simulation",
    "spectra",
    "turbulence",
    "wind",
    "write_report",
]
SUBJECTS = {
    "campaign": ["CampaignPosterior", "campaign_table", "prior_from_stresses"],
    "design": [
        "CompareOptions",
        "CriterionOptions",
        "Plan",
        "ScanLimits",
        "ScanOptimum",
        "Step",
        "compare",
        "enough_beams",
        "estimate",
        "optimize_scan",
        "plan",
        "scan_criterion",
    ],
    "geometry": [
        "ContinuousWaveProbe",
        "PointProbe",
        "Probe",
        "PulsedProbe",
        "STRESSES",
        "Scan",
        "Sight",
        "as_scan",
        "design_matrix",
        "is_realizable",
        "load_scan",
        "make_probe",
        "pack_stress",
        "principal_variances",
        "radial_variance",
        "rotate_stress",
        "save_scan",
        "sight",
        "unpack_stress",
    ],
    "noise": [
        "Boxes",
        "Noise",
        "RecordNoise",
        "SonicMoments",
        "SonicNoise",
        "as_noise",
        "calibrate",
        "load",
        "sonic_moments",
        "theory",
    ],
    "plot": ["budget", "campaign", "comparison", "corner", "lumley", "profile", "scan", "spectra", "stresses"],
    "priors": [
        "CampaignPrior",
        "FlatPrior",
        "GaussianPrior",
        "MannPrior",
        "PRIORS",
        "Prior",
        "RatioPrior",
        "SamplePrior",
        "WeakPrior",
        "load_campaign_prior",
        "make_prior",
    ],
    "quality": [
        "ALWAYS_LISTED",
        "BeamSamples",
        "Filtered",
        "MAD_TO_SIGMA",
        "Periodicity",
        "QualityRules",
        "apply_filters",
        "find_periodicity",
        "group_median",
        "group_moments",
        "in_sectors",
        "is_spike",
    ],
    "readers": [
        "FileFormat",
        "FileOptions",
        "READERS",
        "Rays",
        "Reader",
        "Samples",
        "ScanGroup",
        "SortedFiles",
        "find_scan",
        "read",
        "read_sonic",
        "read_statistics",
        "sort_files",
        "stream",
    ],
    "records": [
        "BEAM_FLAGS",
        "RECORD_FLAGS",
        "REMARK_FLAGS",
        "RecordOptions",
        "StoredRecords",
        "at_range",
        "availability_table",
        "describe_report",
        "make_records",
        "open_record_files",
        "open_records",
        "store_records",
        "stream_records",
    ],
    "simulation": ["BoxGrid", "box_stresses", "export_box", "simulate"],
    "spectra": [
        "along_wind_spectra",
        "average_spectra",
        "estimate_instrument_noise",
        "fit_spectra",
        "pool_length_scale",
        "radial_spectra",
        "with_instrument_noise",
        "with_length_scale",
        "with_own_length_scale",
    ],
    "turbulence": ["MannTurbulence", "cross_spectra", "fit", "load", "velocity_covariance"],
    "wind": [
        "add_motion",
        "beam_mean_covariance",
        "mean_wind",
        "pair_stresses",
        "read_motion",
        "reconstruct_pairs",
        "remove_motion",
        "sonic_stresses",
        "wind_profile",
        "with_mast",
        "with_motion",
    ],
}
"""The names of each subject."""


def test_the_public_names_are_these():
    assert sorted(bayes_rs.__all__) == sorted(PUBLIC)
    assert len(PUBLIC) <= 60


def test_the_subjects_are_these():
    assert {name for name in PUBLIC if isinstance(getattr(bayes_rs, name), ModuleType)} == set(SUBJECTS)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_the_names_of_a_subject_are_these(subject):
    package = getattr(bayes_rs, subject)
    assert sorted(package.__all__) == sorted(SUBJECTS[subject])
    for name in SUBJECTS[subject]:
        assert getattr(package, name) is not None


def test_every_public_name_can_be_had():
    for name in PUBLIC:
        assert getattr(bayes_rs, name) is not None


@pytest.mark.parametrize("subject", ["", *SUBJECTS])
def test_no_module_has_the_name_of_something_public(subject):
    """Importing a module sets it on the package, where it would hide the function of that name."""
    package = getattr(bayes_rs, subject) if subject else bayes_rs
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    assert modules.isdisjoint(set(package.__all__) - set(SUBJECTS if not subject else ()))


def test_names_stay_what_they_are_when_all_modules_are_imported():
    def names():
        of_subjects = {
            (subject, name): getattr(getattr(bayes_rs, subject), name)
            for subject in SUBJECTS
            for name in SUBJECTS[subject]
        }
        return {**{name: getattr(bayes_rs, name) for name in PUBLIC}, **of_subjects}

    before = names()
    for module in pkgutil.walk_packages(bayes_rs.__path__, "bayes_rs."):
        if not module.name.endswith("__main__"):  # that one runs the program
            importlib.import_module(module.name)
    after = names()
    assert all(after[name] is before[name] for name in before)


def test_the_command_line_does_not_load_the_science_for_its_help():
    code = (
        "import sys, bayes_rs.cli; print(sorted({'numpy', 'scipy', 'matplotlib', 'emcee', 'arviz'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603 - our own
    assert done.stdout.strip() == "[]"


class TestWhatIsTaken:
    """Wherever a scan, turbulence or noise is taken, its name or file is, too."""

    def test_names_and_files(self):
        refused = set()
        for where in (bayes_rs, *(getattr(bayes_rs, subject) for subject in SUBJECTS)):
            for name, call in ((name, getattr(where, name)) for name in where.__all__):
                if not inspect.isfunction(call):  # classes are results, or options that hold the name as one
                    continue
                taken = inspect.signature(call).parameters
                for word in {"scan", "turbulence", "noise"} & set(taken):
                    if "str | Path" not in str(taken[word].annotation):
                        refused.add((name, word))
        assert refused == {("save_scan", "scan")}

    def test_other_things_are_refused_in_one_line(self):
        series = bayes_rs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=1, seed=1)
        for call, words in (
            (lambda: bayes_rs.fit(series, "2-beam", seed=1), "Invalid records: they are samples; give make_records"),
            (lambda: bayes_rs.fit("a.csv", "2-beam", seed=1), "Invalid records 'a.csv': give those of make_records"),
            (lambda: bayes_rs.fit(None, "2-beam", seed=1), "Invalid records of type NoneType: give those of"),
            (lambda: bayes_rs.prior_sensitivity(series, "2-beam", seed=1), "Invalid records: they are samples"),
            (lambda: bayes_rs.noise.calibrate("2-beam", records=series), "Invalid records: they are samples"),
            (lambda: bayes_rs.make_records("a.csv", "2-beam"), "Invalid series 'a.csv': give the Dataset of read"),
        ):
            with pytest.raises(bayes_rs.InputError, match=words):
                call()

    @pytest.mark.parametrize("name", ["scan", "turbulence"])
    def test_what_names_no_scan_and_no_turbulence_is_refused_in_one_line(self, name, tmp_path):
        series = bayes_rs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=1, seed=1)
        records = bayes_rs.make_records(series, "2-beam").assign_attrs(comment=f"{'x' * 300}@{'y' * 300}")
        calls = {
            "scan": (
                bayes_rs.plot.scan,
                bayes_rs.load_scan,
                lambda what: bayes_rs.make_records(series, what),
                lambda what: bayes_rs.fit(records, what, seed=1),
                lambda what: bayes_rs.simulate(what, "fu-2022", wind_speed=10.0, n_records=1, seed=1),
                lambda what: bayes_rs.save_scan(what, tmp_path / "a.toml"),
            ),
            "turbulence": (
                bayes_rs.load_turbulence,
                lambda what: bayes_rs.simulate("2-beam", what, wind_speed=10.0, n_records=1, seed=1),
            ),
        }
        for call in calls[name]:
            for what in (records, records["variance"], records.to_dataframe(), records["variance"].values, None):
                with pytest.raises(
                    bayes_rs.InputError, match=rf"^Invalid {name} [^\n]{{0,100}}: it must be a"
                ) as caught:
                    call(what)
                assert len(str(caught.value)) < 150
        for call in calls[name][:1]:
            with pytest.raises(bayes_rs.InputError, match=r"^No file 'x+\.\.\.x+\.toml': give the path"):
                call(f"{'x' * 300}.toml")

    def test_results_are_a_few_lines(self):
        series = bayes_rs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
        noise = bayes_rs.noise.calibrate("2-beam", wind_speed=10.0, cache=False)
        assert (
            repr(noise)
            == "<Noise of scan 2-beam, calculated, fu-2022, method theory, 1 state (10 m/s, yaw 0°, L 61 m)>"
        )
        found = bayes_rs.fit(bayes_rs.make_records(series, "2-beam"), "2-beam", seed=1, noise=noise)
        assert repr(found).splitlines()[0] == "<Fit: 2 of 2 records, scan 2-beam, sampler emcee"
