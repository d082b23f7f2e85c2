"""The road of a fit: the same numbers in memory, in a folder and from a file of settings, and every option arrives."""

import json
from dataclasses import replace

import distributed
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from other_likelihoods import OTHER_LIKELIHOODS
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import FitOptions, MannTurbulence, Noise, Nuisances, Settings
from bayes_rs.fits import plan
from bayes_rs.fits.groups import GROUPS
from bayes_rs.fits.settings import option_places
from bayes_rs.likelihoods.log_normal import LIKELIHOODS
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.options import options_of, to_plain
from bayes_rs.priors import WeakPrior
from bayes_rs.records.beam_correlation import correlated_beams
from bayes_rs.result_folder import ResultFolder

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("short_campaign")]
SMALL = {"seed": 3, "target_ess": 100}
ONLY_IN_FOLDERS = {"finished", "key", "key_parts", "seconds", "n_resumed", "n_fitted", "flags", "words"}
"""What `run.json` holds beside the run of a fit in memory."""


def scene(name, n_record, **overrides):
    """Records of the weak prior, and plain noise."""
    scan = brs.load_scan(name, **overrides)
    noise = plain_noise(scan)
    rng = np.random.default_rng(5)
    return records_of(draw_variances(WeakPrior(log_sd_uu=0.5).draw(n_record, rng), scan, noise, rng), scan), scan, noise


def unfitted(records):
    records["flag"].values[1] = 1
    records["flag"].values[2, 0] = 1
    records["wind_speed"].values[3] = np.nan
    return records


def two_months(records):
    start = np.datetime64("2020-02-29T23:40", "ns") + np.arange(records.sizes["record"]) * np.timedelta64(600, "s")
    return records.assign_coords(time=("record", start))


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(plan, "PART_RECORDS", 3)


def check_same(one, other):
    """Check that a fit in memory and one in a folder are the same, bit by bit, whatever is asked of them."""
    assert one.source.datasets == other.source.datasets
    for name in one.source.datasets:
        pd.testing.assert_frame_equal(one.table(name), other.table(name), check_exact=True)
    pd.testing.assert_frame_equal(one.summary(), other.summary(), check_exact=True)
    pd.testing.assert_frame_equal(one.directions(), other.directions(), check_exact=True)
    np.testing.assert_array_equal(one.covariance(), other.covariance())
    np.testing.assert_array_equal(one.prior_draws, other.prior_draws)
    np.testing.assert_array_equal(one.time, other.time)
    xr.testing.assert_equal(one.records, other.records)
    for name in GROUPS:
        assert (name in one) == (name in other)
        if name in one:
            xr.testing.assert_identical(one[name], other[name])
    for name in ("n_record", "n_fitted", "flags", "words", "failures", "remarks", "attrs", "has_draws"):
        assert getattr(one, name) == getattr(other, name), name
    assert one.scan.key == other.scan.key
    run = {name: value for name, value in other.run.items() if name not in ONLY_IN_FOLDERS}
    of_noise = {**run["settings"]["noise"], "noise": None}  # the folder keeps given noise, as a file that is named here
    run["settings"] = {**run["settings"], "noise": of_noise}
    assert json.loads(json.dumps(one.run)) == run


FLOW = MannTurbulence(dissipation=0.05, length_scale=61.0, gamma=3.2, name="test")
UNCERTAIN = Nuisances(yaw_sd_deg=2.0, instrument_noise_log_sd=0.3, vertical_gradient_sd=0.3)
CASES = {
    "few beams": ("6-beam", lambda records: records, {}),
    "many beams": ("50-beam", lambda records: records, {}),
    "nuisances": ("6-beam", lambda records: records, {"nuisances": UNCERTAIN, "instrument_noise": 0.01}),
    "many beams and nuisances": ("50-beam", unfitted, {"nuisances": UNCERTAIN, "instrument_noise": 0.01}),
    "sonic": ("6-beam", unfitted, {"target": "sonic"}),
    "two processes": ("6-beam", unfitted, {"workers": 2}),
    "without times": ("6-beam", lambda records: records.drop_vars("time"), {}),
    "two months, some unfitted": ("6-beam", lambda records: two_months(unfitted(records)), {}),
    "no draws": ("6-beam", unfitted, {"draws": "none"}),
    "draws of single precision": ("6-beam", unfitted, {"draws": "float32"}),
    "direct or emcee": ("6-beam", unfitted, {"sampler": "auto", "derived": ("ti", "tke"), "prob": 0.5}),
    "campaign": ("6-beam", unfitted, {"campaign": "on"}),
    "campaign of many beams": ("50-beam", unfitted, {"campaign": "on", "workers": 2}),
    "none fitted": ("6-beam", lambda records: records.assign(flag=records["flag"] + 1), {}),
}


class TestMemoryAndFolder:
    @pytest.mark.parametrize("name", list(CASES))
    def test_the_same_bit_by_bit(self, tmp_path, name):
        scan_name, change, options = CASES[name]
        records, scan, noise = scene(scan_name, 8)
        records = change(records)
        if options.get("target") == "sonic":
            noise = theory_noise(scan, FLOW, wind_speed=10.0, sonic=True)
        in_one = {"workers": 1} if name == "campaign of many beams" else {}  # several in memory: "two processes"
        one = brs.fit(records, scan, noise=noise, **{**SMALL, **options, **in_one})
        made = brs.fit(records, scan, noise=noise, output=tmp_path / "out", **{**SMALL, **options})
        for other in (made, brs.open_fit(tmp_path / "out")):
            check_same(one, other)
            if one.has_draws:
                for asked in ({"prob": 0.8}, {"derived": ("ti", "tke")}, {"frame": "lidar"}):
                    pd.testing.assert_frame_equal(one.summary(**asked), other.summary(**asked), check_exact=True)
                asked = {"prob": 0.6, "derived": ("ti", "tke"), "frame": "lidar"}
                pd.testing.assert_frame_equal(one.summary(**asked), other.summary(**asked), check_exact=True)
                xr.testing.assert_identical(one.lidar_frame(), other.lidar_frame())

    def test_a_cluster(self, tmp_path):
        records, scan, noise = scene("6-beam", 8)
        options = {"processes": True, "n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0"}
        with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
            one = brs.fit(records, scan, noise=noise, client=client, **SMALL)
            other = brs.fit(records, scan, noise=noise, output=tmp_path / "out", client=client, **SMALL)
        check_same(one, other)
        check_same(brs.fit(records, scan, noise=noise, **SMALL), other)

    def test_a_corner_plot_of_a_long_fit_reads_the_part_of_its_record_only(self, tmp_path, monkeypatch):
        records, scan, noise = scene("6-beam", 8)
        brs.fit(unfitted(records), scan, noise=noise, output=tmp_path / "out", draws="float32", **SMALL)
        read = []
        reading = ResultFolder.read
        monkeypatch.setattr(ResultFolder, "read", lambda self, name: read.append(name) or reading(self, name))
        figure = brs.plot.corner(brs.open_fit(tmp_path / "out"), 4)
        assert len(figure.axes) == 21  # the lower triangle
        drawn = [name for name in read if name.split("/")[0] in ("draws", "predicted")]
        assert set(drawn) == {"draws/month=2020-01/part-000001.parquet"}

    def test_draws_of_one_record_are_those_of_all(self, tmp_path):
        records, scan, noise = scene("6-beam", 8)
        found = brs.fit(unfitted(records), scan, noise=noise, output=tmp_path / "out", **SMALL)
        every = found.draws()
        for index in np.flatnonzero(found.fitted).tolist():
            np.testing.assert_array_equal(found.draws(index), every[index])
        assert np.isnan(every[~found.fitted]).all()
        rows, draws = zip(*found.batches(), strict=True)
        np.testing.assert_array_equal(np.concatenate(rows), np.flatnonzero(found.fitted))
        np.testing.assert_array_equal(np.concatenate(draws), every[found.fitted])


@pytest.fixture(scope="module")
def records():
    return brs.make_records(brs.simulate("2-beam", "fu-2022", wind_speed=8.0, n_records=3, seed=1), "2-beam")


class TestNoise:
    def test_what_the_records_need_is_made(self, records, tmp_path):
        """Without noise, with that which `calibrate` makes for the records, and with its file: the same numbers."""
        made = brs.noise.calibrate("2-beam", "fu-2022", records=records)
        made.save(tmp_path / "noise.nc")
        scan, own = brs.load_scan("2-beam"), brs.fit(records, "2-beam", turbulence="fu-2022", **SMALL)
        for noise in (made, tmp_path / "noise.nc", str(tmp_path / "noise.nc")):
            found = brs.fit(records, scan, noise=noise, **SMALL)
            for name in ("summary", "posterior", "draws", "predicted"):
                pd.testing.assert_frame_equal(found.table(name), own.table(name), check_exact=True)
        assert own.flags["outside_noise"] == 0

    def test_scan_and_turbulence_by_name_file_and_object(self, records, tmp_path):
        scan = brs.load_scan("2-beam")
        flow = brs.load_turbulence("stable-onshore")
        brs.save_scan(scan, tmp_path / "mine.toml")
        expected = brs.fit(records, scan, noise=brs.noise.calibrate(scan, flow, records=records), **SMALL).summary()
        for of_scan in (scan, "2-beam", tmp_path / "mine.toml", str(tmp_path / "mine.toml")):
            found = brs.fit(records, of_scan, turbulence="stable-onshore", **SMALL)
            assert found.run["noise"]["turbulence"] == flow.name
            pd.testing.assert_frame_equal(found.summary(), expected, check_exact=True)
        other = brs.fit(records, scan, **SMALL)
        assert not other.summary().equals(expected)

    def test_what_was_done_is_said(self, records):
        said = []
        brs.fit(records, "2-beam", say=said.append, **SMALL)
        assert any(line.startswith("noise") for line in said), said

    def test_the_settings_say_how_it_was_made(self, records, tmp_path):
        brs.fit(records, "2-beam", turbulence="stable-onshore", output=tmp_path / "out", **SMALL)
        noise = brs.open_fit(tmp_path / "out").settings["noise"]
        assert (noise["turbulence"], noise["noise"]) == ("stable-onshore", None)

    @pytest.mark.parametrize("name", ["6-beam", "50-beam"])
    def test_noise_of_another_wind_is_flagged_and_counted(self, tmp_path, name):
        records, scan, noise = scene(name, 4)
        records = records.assign(wind_speed=("record", np.full(4, 4.0)))
        storm = replace(noise, wind_speed=16.0)
        for output in (None, tmp_path / "out"):
            found = brs.fit(records, scan, noise=storm, output=output, **SMALL)
            assert found.flags["outside_noise"] == 4
            assert found.attrs["n_outside_noise"] == 4
            assert set(found.summary()["flag"]) == {"outside_noise"}
            assert any("outside_noise" in line and "4 of 4" in line for line in found.remarks), found.remarks
            assert "outside_noise" in brs.write_report(found, tmp_path / "a.html", overwrite=True).read_text()
        assert brs.open_fit(tmp_path / "out").run["flags"]["outside_noise"] == 4
        near = brs.fit(records.assign(wind_speed=("record", np.full(4, 16.0))), scan, noise=storm, **SMALL)
        assert near.flags["outside_noise"] == 0


def scales(noise):
    """Noise over several length scales, the larger the more."""
    states = [
        replace(
            noise,
            covariance=noise.covariance[0] * length_scale / 61.0,
            turbulence=replace(noise.turbulence, length_scale=length_scale),
            length_scale=length_scale,
        )
        for length_scale in (15.0, 30.0, 61.0, 120.0, 240.0)
    ]
    return Noise.join(states)


OPTION_CASES = {
    "seed": ({}, {"seed": 4}),
    "prior": ({}, {"prior": "flat"}),
    "target": ({}, {"target": "ensemble"}),
    "sampler": ({}, {"sampler": "direct"}),
    "likelihood": ({}, {"likelihood": "gamma"}),
    "target_ess": ({}, {"target_ess": 5000}),
    "information": ({}, {"information": "covariances"}),
    "coherence_log_sd": ({"information": "covariances"}, {"coherence_log_sd": 0.8}),
    "mast_log_sd": ({}, {"mast_log_sd": 0.5}),
    "max_extension": ({"target_ess": 1500, "prior": "flat"}, {"max_extension": 0}),
    "monte_carlo_error": ({}, {"monte_carlo_error": 0.05}),
    "instrument_noise": ({}, {"instrument_noise": 0.05}),
    "nuisances": ({}, {"nuisances": Nuisances(tilt_sd_deg=3.0)}),
    "prob": ({}, {"prob": 0.5}),
    "interval": ({}, {"interval": "highest-density"}),
    "derived": ({}, {"derived": ("tke", "ti")}),
    "draws": ({}, {"draws": "none"}),
    "scatter": ({}, {"scatter": "theory"}),
    "unsteady_level": ({}, {"unsteady_level": 0.0}),
    "campaign": ({"campaign_unsteady": True}, {"campaign": "on"}),
    "campaign_group": ({"campaign": "on", "campaign_unsteady": True}, {"campaign_group": "stability"}),
    "campaign_unsteady": ({"campaign": "on"}, {"campaign_unsteady": True}),
}
"""Say here what an option changes: other options that it needs, and another value."""
NUISANCE_CASES = {
    "yaw_sd_deg": ({}, {"yaw_sd_deg": 5.0}),
    "yaw_sd_missing_deg": ({"yaw_sd_deg": "records", "yaw_sd_missing_deg": 2.0}, {"yaw_sd_missing_deg": 20.0}),
    "tilt_sd_deg": ({}, {"tilt_sd_deg": 3.0}),
    "instrument_noise_log_sd": ({}, {"instrument_noise_log_sd": 0.8}),
    "length_scale_log_sd": ({"length_scale_log_sd": 0.1, "length_scale": 61.0}, {"length_scale_log_sd": 0.5}),
    "length_scale": ({"length_scale_log_sd": 0.2, "length_scale": 61.0}, {"length_scale": 90.0}),
    "probe_length_log_sd": ({}, {"probe_length_log_sd": 0.5}),
    "vertical_gradient_sd": ({}, {"vertical_gradient_sd": 0.8}),
    "lateral_gradient_sd": ({}, {"lateral_gradient_sd": 0.8}),
    "inflation": ({}, {"inflation": 1.5}),
    "inflation_dof": ({}, {"inflation_dof": 4.0}),
}
"""The same for the nuisances."""
NEEDS = {"instrument_noise_log_sd": {"instrument_noise": 0.05}}
"""Options of the fit that a nuisance needs."""
OTHER_SCAN = {"probe_length_log_sd": "@probe=zx-tm"}
"""What a nuisance needs of the scan."""
WHATEVER_BEAMS = {
    *("seed", "sampler", "target_ess", "max_extension", "monte_carlo_error", "prob", "interval", "derived", "draws"),
    *("unsteady_level", "campaign_group", "campaign_unsteady"),
}
"""Options of what is done with a likelihood, or without one: with many beams in the long run only."""
MAST = " beside a mast"
"""The scene of what needs one."""


def cases(cls, known):
    """Few and many beams with the fields of a class of options, and what they change; a field without a case fails."""
    return [
        pytest.param(
            beams,
            entry.name,
            known.get(entry.name),
            id=f"{entry.name}-{beams}",
            marks=[pytest.mark.long] * (beams == "50-beam" and entry.name in WHATEVER_BEAMS),
        )
        for beams in ("6-beam", "50-beam")
        for entry in options_of(cls)
    ]


def told(found):
    """What a fit says, but for its settings and what follows from them in words."""
    tables = {name: found.table(name) for name in found.source.datasets}
    return {**tables, "summary": found.summary()}


def differ(one, other):
    if one.keys() != other.keys():
        return True
    return any(not one[name].equals(other[name]) for name in one)


def parts_of(scan):
    """Statistics of the parts of two records: both scatter much, and one has a front."""
    rng = np.random.default_rng(7)
    wind = 10.0 + 0.1 * rng.standard_normal((2, 2, 64))
    wind[:, 0, 16:] += 5.0
    return {
        "part_beams": ("record", np.full(2, 2 ** min(scan.n_beam, 8) - 1, dtype=np.int16)),
        "part_wind": (("record", "part"), wind[0]),
        "part_wind_across": (("record", "part"), wind[1] - 10.0),
        "block_scatter": (("record", "blocks"), np.full((2, 3), 1.0)),
        "block_scatter_of_beams": (("record", "blocks"), np.full((2, 3), 1.5)),
    }


def with_correlations(records, scan):
    """Records whose beams go together, all pairs alike."""
    numbers = correlated_beams(scan)
    values = np.full((records.sizes["record"], len(numbers) * (len(numbers) - 1) // 2), 0.6)
    return records.assign(beam_correlation=(("record", "beam_pair"), values)).assign_attrs(
        correlated_beams=json.dumps(numbers.tolist())
    )


@pytest.fixture(scope="module")
def scenes_of(tmp_path_factory):
    """For few and many beams: records, scan, noise, and files of records and noise."""
    made = {}
    for name in ("6-beam", "50-beam", "6-beam@probe=zx-tm", "50-beam@probe=zx-tm"):
        folder = tmp_path_factory.mktemp(name)
        records, scan, noise = scene(name, 2)
        records = records.assign(yaw_sd=("record", [np.nan, 1.0]), **parts_of(scan))
        unsteady = ("record", [0, 1], {"flag_meanings": "not_stationary", "flag_masks": [1]})
        records = records.assign(record_flag=unsteady)
        records = records.assign(stability=("record", np.array(["stable", "neutral"], dtype=object)))
        records = with_correlations(records, scan)
        bank = scales(noise)
        for more in ("", MAST):
            beside = folder / f"records{more}"
            beside.mkdir()
            own = records
            if more:
                own = records.assign(
                    mast_stress=(("record", "stress"), np.tile([1.2, 0.7, 0.4, 0.0, -0.3, 0.0], (2, 1)))
                )
                own = own.assign_attrs(mast_position="[-98.0, 0.0, 0.0]")
            own.to_netcdf(beside / "records.nc", engine="h5netcdf")
            noise.save(beside / "plain.nc")
            bank.save(beside / "scales.nc")
            made[name + more] = (own, scan, {"plain": noise, "scales": bank}, beside)
    return made


@pytest.fixture(scope="module")
def base_fits():
    return {}


def check_arrives(scene, base_fits, name, base, changed, tmp_path, kind="plain"):
    """A changed value changes the numbers, and they are the same on all three ways; return the folder's settings."""
    records, scan, noise, files = scene
    base, changed = {**SMALL, **base}, {**SMALL, **base, **changed}
    key = (scan.name, files.name, kind, repr(sorted(base.items())))
    if key not in base_fits:
        base_fits[key] = told(brs.fit(records, scan, noise=noise[kind], **base))
    in_memory = brs.fit(records, scan, noise=noise[kind], **changed)
    assert differ(told(in_memory), base_fits[key]), f"{name} changes nothing"
    folder = brs.fit(records, scan, noise=noise[kind], output=tmp_path / "out", **changed)
    assert not differ(told(folder), told(in_memory))
    plain = {**changed, "files": [str(files / "records.nc")], "noise": str(files / f"{kind}.nc"), "scan": scan.name}
    Settings().changed(**plain, output=str(tmp_path / "from-file")).save(tmp_path / "settings.toml")
    from_file = brs.fit_files(Settings.load(tmp_path / "settings.toml").changed(output=str(tmp_path / "from-file")))
    assert not differ(told(from_file), told(in_memory))
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert from_file.settings["fit"] == run["settings"]["fit"]
    return run["settings"]["fit"]


@pytest.mark.usefixtures("no_groups_file")
class TestEveryOptionArrives:
    @pytest.fixture(autouse=True)
    def another_likelihood(self, monkeypatch):
        """There is one; another is registered, so that its name can be told apart from the default."""
        monkeypatch.setitem(LIKELIHOODS, "gamma", OTHER_LIKELIHOODS["gamma"])

    @pytest.mark.parametrize(("beams", "name", "case"), cases(FitOptions, OPTION_CASES))
    def test_of_the_fit(self, scenes_of, base_fits, beams, name, case, tmp_path):
        assert case is not None, f"say in OPTION_CASES what {name} changes"
        scene = scenes_of[beams + MAST * (name == "mast_log_sd")]
        settings = check_arrives(scene, base_fits, name, *case, tmp_path)
        value = case[1][name]
        assert settings[name] == (to_plain(value) if isinstance(value, Nuisances) else json.loads(json.dumps(value)))

    @pytest.mark.parametrize(("beams", "name", "case"), cases(Nuisances, NUISANCE_CASES))
    def test_of_the_nuisances(self, scenes_of, base_fits, beams, name, case, tmp_path):
        assert case is not None, f"say in NUISANCE_CASES what {name} changes"
        base, changed = ({**one} for one in case)
        more = NEEDS.get(name, {})
        settings = check_arrives(
            scenes_of[beams + OTHER_SCAN.get(name, "")],
            base_fits,
            name,
            {**more, "nuisances": Nuisances(**base)},
            {"nuisances": Nuisances(**{**base, **changed})},
            tmp_path,
            "scales" if "length_scale" in name else "plain",
        )
        assert settings["nuisances"][name] == changed[name]


def test_every_field_has_its_case_and_every_case_its_field():
    for cls, known in ((FitOptions, OPTION_CASES), (Nuisances, NUISANCE_CASES)):
        assert {entry.name for entry in options_of(cls)} == set(known)
    assert set(OPTION_CASES) | set(NUISANCE_CASES) <= set(option_places())
    assert set(OPTION_CASES) > WHATEVER_BEAMS
