"""Fuzz of Python: every public function and class, with one or two arguments that are extreme or of another kind."""

import inspect
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fuzz.frame import Case, python
from fuzz.hostile import scene

_PLAIN: tuple[Any, ...] = (
    0,
    1,
    -1,
    3,
    0.5,
    1e9,
    -1e9,
    1e-9,
    1e300,
    -1e300,
    1e-300,
    np.nan,
    np.inf,
    -np.inf,
    2**63,
    2**70,
    -(2**70),
    10**400,
    "3.2",
    "",
    "abc",
    "x" * 1000,
    "a\nb",
    "\u202e☃",
    None,
    True,
    False,
    1j,
    b"3",
    (),
    [],
    {},
    [1e300],
    [np.nan],
    [None],
    ["3"],
    (1.0, 2.0),
    (2.0, 1.0),
    [1.0, 2.0, 3.0],
    [[1.0]],
    {"a": 1},
    {0: (1e300, -1e300)},
    np.float32(3.0),
    np.int8(3),
    np.datetime64("NaT"),
    Path("x"),
    object,
)
VALUES: tuple[Callable[[], Any], ...] = (
    *((lambda value=value: value) for value in _PLAIN),
    object,
    lambda: np.array(3.0),
    lambda: np.array("3"),
    lambda: np.array([]),
    lambda: np.array([1.0, 2.0]),
    lambda: np.array([1.0, np.inf]),
    lambda: np.array([1j]),
    lambda: np.array([None, 1.0]),
    lambda: np.array([True, False]),
    lambda: np.full((3, 3), 1e300),
    lambda: np.eye(3),
    lambda: np.complex128(1j),
    lambda: np.ma.masked,
    lambda: np.random.default_rng(1),
    lambda: iter([1.0]),
)
"""Values that no one means, each made anew."""
_KEPT = {
    "progress",
    "say",
    "client",
    "output",
    "overwrite",
    "resume",
    "folder",
    "figure",
    "name",
    "title",
    "source",
    "unsteady",
}
"""Arguments that are no numbers and no choices, or that the frame itself gives."""
_DATA = {"records", "series", "spectra", "fit", "table", "path", "files", "settings", "motion", "pooled", "noise_of"}


def cases(seed: int, n: int) -> Iterator[Case]:
    """Return `n` calls with extreme arguments."""
    rng = random.Random(seed)  # noqa: S311 - no secret
    calls = _calls()
    for number in range(n):
        name = rng.choice(list(calls))
        call, base, names = calls[name]
        changed: dict[str, Any] = {}
        words = []
        for key in rng.sample(names, min(rng.randint(1, 2), len(names))):
            index = rng.randrange(len(VALUES))
            changed[key] = VALUES[index]
            words.append(f"{key}={_short(VALUES[index]())}")
        yield Case(f"python {seed}:{number} {name}({', '.join(words)})", python(_run(call, base, changed)))


def _run(call: Any, base: dict[str, Any], changed: dict[str, Callable[[], Any]]) -> Callable[[Path], object]:
    def run(_folder: Path) -> object:
        found = call(**{**base, **{key: make() for key, make in changed.items()}})
        return [*found] if inspect.isgenerator(found) else found

    return run


def _short(value: object) -> str:
    return repr(value)[:60]


def _calls() -> dict[str, tuple[Any, dict[str, Any], list[str]]]:
    """Return calls by name: what is called, arguments with which it works, and which of all are replaced."""
    from bayes_rs.options import options_of  # noqa: PLC0415 - loaded once, before the processes are forked

    one = scene()
    brs, scan = one.brs, one.scan
    flow = brs.load_turbulence("fu-2022")
    stress = flow.stresses()
    data = {"records": one.records, "series": one.series, "scan": scan}
    spectra = brs.spectra.radial_spectra(one.series, scan, one.records)
    of_wind = {"scan": scan, "turbulence": flow, "wind_speed": 10.0}
    short = {**of_wind, "duration": 60.0}
    quick = {"noise": one.noise, "target_ess": 50, "campaign": "off", "seed": 1, "progress": False}
    fitted = brs.spectra.fit_spectra(spectra, scan, progress=False)
    series_1 = brs.read(one.place / "series.csv", scan)
    table = brs.compare(
        ["6-beam@n_beams=4", "6-beam@n_beams=6"], n_records=4, estimators=(), duration=60.0, progress=False
    )
    bases: list[tuple[Any, dict[str, Any]]] = [
        (brs.MannTurbulence, {"dissipation": 0.05, "length_scale": 61.0, "gamma": 3.2}),
        (
            brs.Scan,
            {
                "name": "mine",
                "beam_direction": scan.beam_direction,
                "focus_distance": scan.focus_distance,
                "beam_time": scan.beam_time,
                "scan_duration": 1.0,
            },
        ),
        (brs.load_scan, {"name": "6-beam"}),
        (brs.simulate, {**short, "seed": 1}),
        (brs.make_records, {"series": one.series, "scan": scan, "duration": 60.0}),
        (brs.read, {"files": one.place / "series.csv", "scan": scan}),
        (brs.fit, {"records": one.records, "scan": scan, **quick}),
        (brs.prior_sensitivity, {"records": one.records, "scan": scan, **_without(quick, "campaign")}),
        (brs.compare_inflow, {"records": one.records, "scan": scan, **_without(quick, "campaign"), "n_draw": 200}),
        (brs.inflow_confounding, {"scan": "6-beam", "stress": stress}),
        (brs.estimate, {"records": one.records, "scan": scan, "noise": one.noise}),
        (brs.plan, {**of_wind}),
        (brs.compare, {"scans": "staring", "n_records": 4, "duration": 60.0, "progress": False}),
        (
            brs.optimize_scan,
            {"n_beams": 6, "max_angle_deg": 30.0, "criterion": "trace", "n_starts": 1, "progress": False},
        ),
        (brs.design.scan_criterion, {"scan": "6-beam", "criterion": "width", "duration": 60.0}),
        (brs.design.enough_beams, {"table": table}),
        (brs.find_scan, {"files": one.place / "series.csv", "distance": 98.0}),
        (brs.noise.calibrate, {**short, "cache": False, "progress": False}),
        (brs.noise.theory, short),
        (brs.noise.sonic_moments, short),
        (brs.noise.Boxes, {"n_boxes": 2}),
        (brs.geometry.ContinuousWaveProbe, {"rayleigh_length": 6.0}),
        (brs.geometry.PulsedProbe, {"gate_length": 30.0}),
        (brs.geometry.make_probe, {"kind": "pulsed", "gate_length": 30.0}),
        (brs.geometry.design_matrix, {"scan": scan}),
        (brs.geometry.is_realizable, {"stress": stress}),
        (brs.geometry.principal_variances, {"stress": stress}),
        (brs.geometry.radial_variance, {"scan": scan, "stress": stress}),
        (brs.geometry.rotate_stress, {"stress": stress, "rotation": np.eye(3)}),
        (brs.geometry.pack_stress, {"tensor": np.eye(3)}),
        (brs.geometry.unpack_stress, {"stress": stress}),
        (brs.geometry.sight, {"scan": scan}),
        (brs.priors.FlatPrior, {}),
        (brs.priors.WeakPrior, {}),
        (brs.priors.RatioPrior, {}),
        (brs.priors.MannPrior, {}),
        (brs.priors.GaussianPrior, {"mean": stress, "covariance": np.eye(6)}),
        (brs.priors.SamplePrior, {"stresses": brs.priors.WeakPrior().draw(40, 1)}),
        (brs.priors.make_prior, {"prior": "weak"}),
        (brs.priors.WeakPrior().draw, {"n_draw": 10, "seed": 1}),
        (brs.priors.WeakPrior().interval_widths, {"prob": 0.9}),
        (brs.priors.WeakPrior().widened, {"factor": 2.0}),
        (brs.campaign.prior_from_stresses, {"stress": np.tile(stress, (12, 1)), "wind_speed": np.full(12, 10.0)}),
        (brs.spectra.radial_spectra, data),
        (brs.spectra.average_spectra, {"spectra": spectra}),
        (brs.spectra.fit_spectra, {"spectra": spectra, "scan": scan, "progress": False}),
        (brs.spectra.along_wind_spectra, {"spectra": spectra, "scan": scan, "fit": fitted}),
        (brs.spectra.estimate_instrument_noise, {"spectra": spectra, "scan": scan, "turbulence": flow}),
        (brs.spectra.with_own_length_scale, {"records": one.records, "scan": scan}),
        (brs.turbulence.cross_spectra, {"wave_number": [0.01], "separation": [1.0, 2.0], "turbulence": flow}),
        (brs.turbulence.fit, {"stress": stress, "length_scale": 61.0}),
        (brs.turbulence.velocity_covariance, {"separation": [1.0, 0.0, 0.0], "turbulence": flow}),
        (brs.wind.beam_mean_covariance, short),
        (brs.wind.mean_wind, {"records": one.records, "scan": scan, "turbulence": flow}),
        (brs.wind.pair_stresses, of_wind),
        (brs.wind.reconstruct_pairs, {"series": series_1, "scan": scan}),
        (brs.wind.wind_profile, {"records": one.records, "scan": scan, "turbulence": flow, "hub_height": 90.0}),
        (brs.records.availability_table, {"records": one.records}),
        (brs.readers.stream, {"files": one.place / "series.csv", "scan": scan}),
        (brs.records.stream_records, {"series": [one.series], "scan": scan, "duration": 60.0}),
        (brs.plot.corner, {"fit": one.fit}),
        (brs.plot.lumley, {"fit": one.fit}),
        (brs.plot.stresses, {"fit": one.fit}),
        (brs.plot.spectra, {"spectra": spectra}),
        (brs.write_report, {"fit": one.fit, "output": "report.html"}),
        (one.fit.summary, {}),
    ]
    classes = [
        (brs.FitOptions, {}),
        (brs.Nuisances, {}),
        (brs.QualityRules, {}),
        (brs.readers.FileOptions, {}),
        (brs.records.RecordOptions, {}),
        (brs.design.CompareOptions, {}),
        (brs.design.CriterionOptions, {}),
        (brs.design.ScanLimits, {"max_angle_deg": 30.0}),
        (brs.Settings().changed, {}),
    ]
    keywords = {
        brs.fit: (brs.FitOptions,),
        brs.compare: (brs.design.CompareOptions,),
        brs.optimize_scan: (brs.design.ScanLimits, brs.design.CriterionOptions),
        brs.make_records: (brs.records.RecordOptions,),
        brs.read: (brs.readers.FileOptions,),
        brs.Settings().changed: (brs.FitOptions, brs.Nuisances, brs.QualityRules, brs.records.RecordOptions),
    }
    found: dict[str, tuple[Any, dict[str, Any], list[str]]] = {}
    for call, base in [*bases, *classes]:
        own = [
            key
            for key, parameter in inspect.signature(call).parameters.items()
            if parameter.kind is not parameter.VAR_KEYWORD and key not in _KEPT | _DATA | {"workers"}
        ]
        own += [entry.name for cls in keywords.get(call, ()) for entry in options_of(cls) if entry.name != "motion"]
        name = getattr(call, "__qualname__", call.__name__)
        if own:
            found[name] = (call, base, list(dict.fromkeys(own)))
    return found


def _without(options: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in options.items() if name not in names}
