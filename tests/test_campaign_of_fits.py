"""The campaign of a fit: which records enter, the same numbers on every way, and what is said and drawn of it."""

import io
import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import FitOptions, InputError, Settings
from bayes_rs.campaign import sampling
from bayes_rs.fits import campaign_job, campaign_stage, plan
from bayes_rs.fits.campaign_groups import MOST_GROUPS, campaign_groups
from bayes_rs.fits.campaign_job import campaign_posterior, join_batches
from bayes_rs.fits.campaign_records import campaign_records
from bayes_rs.fits.campaign_words import campaign_failures, campaign_words
from bayes_rs.fits.fit_options import CAMPAIGN_FROM
from bayes_rs.fits.flags import FLAGS
from bayes_rs.fits.prepare import prepare
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.likelihoods.joining import join_likelihoods
from bayes_rs.plot.campaign_plot import record_means, speed_bins
from bayes_rs.posteriors.nuisance import Nuisances
from bayes_rs.priors import WeakPrior

SMALL = {"seed": 3, "target_ess": 100, "sampler": "auto"}
N_RECORD = 12


def scene(n_record=N_RECORD, name="6-beam@opening_angle_deg=45"):
    """Records of the weak prior with winds near 10 m/s, and plain noise."""
    scan = brs.load_scan(name)
    noise, rng = plain_noise(scan), np.random.default_rng(5)
    stress = WeakPrior(log_sd_uu=0.3).draw(n_record, rng)
    records = records_of(draw_variances(stress, scan, noise, rng), scan)
    records["wind_speed"].values[:] = rng.uniform(9.2, 10.8, n_record)
    return records, scan, noise


def few_sweeps(patch):
    """Few sweeps, and small parts: what is tested is the way of the numbers, not how good they are."""
    patch.setattr(sampling, "_BURN_IN", (10, 10))
    few = partial(campaign_job.sample_campaign, target_ess=10, most_sweeps=20)
    patch.setattr(campaign_job, "sample_campaign", few)
    patch.setattr(plan, "PART_RECORDS", 5)


@pytest.fixture
def quick(monkeypatch):
    few_sweeps(monkeypatch)


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """Records, scan and options; their fit in memory, and its folder."""
    records, scan, noise = scene()
    records["flag"].values[1] = 1  # not fitted
    options = {**SMALL, "noise": noise, "campaign": "on"}
    whole = tmp_path_factory.mktemp("once") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        few_sweeps(patch)
        one = brs.fit(records, scan, **options)
        brs.fit(records, scan, output=whole, **options)
    return records, scan, options, one, whole


@pytest.fixture
def made(once, tmp_path, quick):  # noqa: ARG001 - it is on
    """The same, and a folder of one's own in place of that of the fit."""
    return *once[:4], tmp_path


@pytest.fixture
def copied(once, tmp_path):
    """A copy of the folder of the fit."""
    return Path(shutil.copytree(once[4], tmp_path / "copy"))


def check_same(one, other):
    assert one.source.datasets == other.source.datasets
    for name in one.source.datasets:
        pd.testing.assert_frame_equal(one.table(name), other.table(name), check_exact=True)
    assert one.run["campaign"] == other.run["campaign"]


def read_bytes(folder):
    """The bytes of all results of a folder but for those with times of the run in them."""
    files = [file for file in sorted(Path(folder).rglob("*")) if file.is_file()]
    skipped = ("run.json", "fingerprints.jsonl")
    return {str(file.relative_to(folder)): file.read_bytes() for file in files if file.name not in skipped}


class TestOptions:
    def test_true_and_false_are_on_and_off(self):
        assert (FitOptions(campaign=True).campaign, FitOptions(campaign=False).campaign) == ("on", "off")

    @pytest.mark.parametrize(
        ("options", "word"),
        [
            ({"prior": "flat"}, "not of flat"),
            ({"prior": "mann"}, "not of mann"),
            ({"target": "sonic"}, "sonic"),
        ],
    )
    def test_what_cannot_be_learnt_is_refused_if_asked_for_and_off_otherwise(self, options, word):
        with pytest.raises(InputError, match=word):
            FitOptions(campaign="on", **options)
        every = np.zeros(CAMPAIGN_FROM, dtype=np.int64)
        chosen = campaign_records(every, FitOptions(**options))
        assert len(chosen.record) == 0
        assert word in chosen.why_not

    @pytest.mark.parametrize("options", [{"campaign_group": "hour"}, {"campaign_unsteady": True}])
    def test_options_of_a_campaign_that_is_off_are_refused(self, options):
        with pytest.raises(InputError, match=next(iter(options))):
            FitOptions(campaign="off", **options)

    def test_another_word_is_refused(self):
        with pytest.raises(InputError, match="campaign"):
            FitOptions(campaign="maybe")


class TestWhichRecordsEnter:
    def flags(self, **some):
        flag = np.zeros(CAMPAIGN_FROM + len(some), dtype=np.int64)
        for index, name in enumerate(some):
            flag[index] = FLAGS[name]
        return flag

    @pytest.mark.parametrize("name", ["no_wind", "likelihood_failed", "outside_noise", "beams_disagree"])
    def test_a_record_with_this_flag_stays_out(self, name):
        chosen = campaign_records(self.flags(**{name: 1}), FitOptions())
        np.testing.assert_array_equal(chosen.record, np.arange(1, CAMPAIGN_FROM + 1))

    @pytest.mark.parametrize("name", ["short_chain", "beam_left_out", "low_wind", "weights_uneven"])
    def test_a_record_with_this_flag_enters(self, name):
        assert len(campaign_records(self.flags(**{name: 1}), FitOptions()).record) == CAMPAIGN_FROM + 1

    def test_unsteady_records_enter_if_they_are_asked_for(self):
        flag = self.flags(not_stationary=1)
        assert 0 not in campaign_records(flag, FitOptions()).record
        assert 0 in campaign_records(flag, FitOptions(campaign_unsteady=True)).record

    def test_it_begins_at_a_number_of_records_or_where_it_is_asked_for(self):
        few, enough = np.zeros(CAMPAIGN_FROM - 1, dtype=np.int64), np.zeros(CAMPAIGN_FROM, dtype=np.int64)
        assert len(campaign_records(enough, FitOptions()).record) == CAMPAIGN_FROM
        chosen = campaign_records(few, FitOptions())
        assert len(chosen.record) == 0
        assert f"{CAMPAIGN_FROM - 1} of {CAMPAIGN_FROM - 1} records" in chosen.why_not
        assert len(campaign_records(few, FitOptions(campaign="on")).record) == CAMPAIGN_FROM - 1
        for flag in (few, enough):
            off = campaign_records(flag, FitOptions(campaign="off"))
            assert (len(off.record), off.why_not) == (0, "")

    @pytest.mark.parametrize("number", [0, 1])
    def test_without_two_records_there_is_none_even_if_asked_for(self, number):
        flag = np.full(40, FLAGS["no_wind"])
        flag[:number] = 0
        chosen = campaign_records(flag, FitOptions(campaign="on"))
        assert len(chosen.record) == 0
        assert chosen.why_not == f"{number} of 40 records can enter (fitted, steady, not flagged), and it begins at 2"


class TestGroups:
    def records(self, **variables):
        n = len(next(iter(variables.values())))
        time = np.datetime64("2020-06-01T22:00", "ns") + np.arange(n) * np.timedelta64(3600, "s")
        coords = {"time": ("record", time)}
        return xr.Dataset({name: ("record", np.asarray(values)) for name, values in variables.items()}, coords=coords)

    def test_none(self):
        assert campaign_groups(self.records(yaw=[1.0]), None) is None

    def test_a_direction_belongs_to_one_sector_however_often_it_goes_round(self):
        angle = np.array([-15.0, 14.9, 344.0, 15.0, 0.0])
        first = campaign_groups(self.records(yaw=angle), "direction")
        for turns in (-1, 1, 2):
            np.testing.assert_array_equal(campaign_groups(self.records(yaw=angle + 360.0 * turns), "direction"), first)
        assert first.tolist() == [
            "345 to 15 degrees",
            "345 to 15 degrees",
            "315 to 345 degrees",
            "15 to 45 degrees",
            "345 to 15 degrees",
        ]

    def test_the_compass_counts_before_the_lidars_axis(self):
        records = self.records(yaw=[0.0], wind_direction=[270.0])
        assert campaign_groups(records, "direction").tolist() == ["255 to 285 degrees"]

    def test_hours_and_wind_speeds(self):
        records = self.records(wind_speed=[3.9, 4.0, np.nan])
        assert campaign_groups(records, "hour").tolist() == ["20 to 24 h UTC", "20 to 24 h UTC", "0 to 4 h UTC"]
        assert campaign_groups(records, "wind_speed").tolist() == ["0 to 4 m/s", "4 to 8 m/s", "unknown"]

    @pytest.mark.parametrize("values", [["stable", "", "neutral"], [1, 2, 1], [1.0, np.nan, 3.0], [True, False, True]])
    def test_a_variable_of_the_records(self, values):
        group = campaign_groups(self.records(stability=values), "stability").tolist()
        first = str(int(values[0])) if isinstance(values[0], float) else str(values[0])
        assert group[0] == first
        missing = values[1] == "" or (isinstance(values[1], float) and np.isnan(values[1]))
        assert group[1] == ("unknown" if missing else str(values[1]))

    @pytest.mark.parametrize(
        ("variables", "name", "word"),
        [
            ({"yaw": [1.0]}, "stability", "stability"),
            ({"z_over_l": [0.1, 0.2]}, "z_over_l", "fractions"),
            ({"number": list(range(MOST_GROUPS + 1))}, "number", f"at most {MOST_GROUPS}"),
        ],
    )
    def test_what_cannot_be_a_class_is_refused(self, variables, name, word):
        with pytest.raises(InputError, match=word):
            campaign_groups(self.records(**variables), name)

    def test_records_without_times_have_no_hours(self):
        with pytest.raises(InputError, match="no times"):
            campaign_groups(self.records(yaw=[1.0]).drop_vars("time"), "hour")


class TestPosteriorOfTheCampaign:
    def batch(self, **options):
        records, scan, noise = scene()
        records["flag"].values[4, 2] = 1
        own = FitOptions(**options)
        _, noise, batch = prepare(records, scan, noise, own)
        return batch, noise, own

    @pytest.mark.parametrize("options", [{}, {"nuisances": Nuisances(yaw_sd_deg=3.0), "prior": "ratio"}])
    def test_in_pieces_it_is_that_of_all(self, monkeypatch, options):
        batch, noise, own = self.batch(**options)
        known, whole = campaign_posterior(batch, noise, own)
        np.testing.assert_array_equal(known, np.arange(N_RECORD))
        monkeypatch.setattr(campaign_job, "batch_size", lambda n_beam: 5)  # noqa: ARG005
        _, pieces = campaign_posterior(batch, noise, own)
        draw = np.random.default_rng(1).standard_normal((N_RECORD, 7, whole.n_coordinate))
        expected = np.concatenate(
            [
                campaign_posterior(batch.take(slice(i, i + 1)), noise, own)[1].log_density(draw[i : i + 1])
                for i in range(N_RECORD)
            ]
        )
        for posterior in (whole, pieces):
            np.testing.assert_allclose(posterior.log_density(draw), expected, rtol=1e-12)

    def test_mixtures_are_joined_node_by_node(self):
        from bayes_rs.likelihoods.mixture import MixtureLikelihood  # noqa: PLC0415 - beside its use

        batch, noise, own = self.batch()
        _, posterior = campaign_posterior(batch, noise, own)
        one = posterior.likelihood
        other = campaign_posterior(batch, noise, FitOptions(nuisances=Nuisances(inflation=2.0)))[1].likelihood
        mixture = MixtureLikelihood((one, other), np.array([0.3, 0.7]))
        halves = [mixture.take(np.arange(4)), mixture.take(np.arange(4, N_RECORD))]
        stress = WeakPrior().draw(N_RECORD * 3, 1).reshape(N_RECORD, 3, 6)
        np.testing.assert_allclose(
            join_likelihoods(halves).log_density(stress), mixture.log_density(stress), rtol=1e-13
        )

    def test_a_record_whose_likelihood_fails_is_left_out(self, monkeypatch):
        batch, noise, own = self.batch()
        make = campaign_job.make_posterior

        def failing(part, *arguments):
            if batch.key[7] in part.key:
                raise np.linalg.LinAlgError("singular")
            return make(part, *arguments)

        monkeypatch.setattr(campaign_job, "make_posterior", failing)
        known, posterior = campaign_posterior(batch, noise, own)
        assert known.tolist() == [index for index in range(N_RECORD) if index != 7]
        assert posterior.n_record == N_RECORD - 1

    def test_batches_are_joined_field_by_field(self):
        batch, _, _ = self.batch(campaign_group="hour")
        joined = join_batches([batch.take(slice(0, 5)), batch.take(slice(5, None))])
        for name in batch.__dataclass_fields__:
            whole, pieces = getattr(batch, name), getattr(joined, name)
            if isinstance(whole, np.ndarray):
                np.testing.assert_array_equal(pieces, whole)
            else:
                assert pieces == whole
        assert joined.group is not None


@pytest.mark.slow
class TestTheRoad:
    def test_in_a_folder_as_in_memory(self, once):
        _, _, _, one, whole = once
        other = brs.open_fit(whole)
        check_same(one, other)
        assert one.words == other.words
        assert one.failures == other.failures
        first, second = one.campaign_prior(), other.campaign_prior()
        draw = np.random.default_rng(2).standard_normal((4, 6))
        np.testing.assert_array_equal(first.log_density(draw), second.log_density(draw))

    def test_two_workers_as_one(self, made, once):
        records, scan, options, one, place = made
        check_same(one, brs.fit(records, scan, output=place / "out", workers=2, **options))
        assert read_bytes(place / "out") == read_bytes(once[4])

    def test_the_records_under_it_are_those_of_a_fit_with_its_prior(self, made):
        """A fit that is given the learnt prior and draws directly is the same by another way."""
        records, scan, options, one, _ = made
        again = brs.fit(
            records, scan, **{**options, "campaign": "off", "prior": one.campaign_prior(), "sampler": "direct"}
        )
        columns = [name for name in one.summary().columns if name not in ("contraction", "contraction_shape")]
        columns = [name for name in columns if not name.startswith("decided")]
        pd.testing.assert_frame_equal(one.summary(campaign=True)[columns], again.summary()[columns], check_exact=True)

    def test_without_it_the_other_numbers_are_the_same_bit_by_bit(self, made):
        records, scan, options, one, _ = made
        off = brs.fit(records, scan, **{**options, "campaign": "off"})
        assert not off.has_campaign
        for name in off.source.datasets:
            pd.testing.assert_frame_equal(off.table(name), one.table(name), check_exact=True)
        assert set(one.source.datasets) - set(off.source.datasets) == {"campaign", "campaign_hyper", "campaign_summary"}

    @pytest.mark.parametrize(
        "stop", ["before the campaign", "before its last file", "in the second pass", "after all of it"]
    )
    def test_stopped_between_the_stages_and_resumed(self, made, once, monkeypatch, stop):
        records, scan, options, one, place = made

        def fail(*_arguments, **_options):
            raise KeyboardInterrupt

        names = {
            "before the campaign": (campaign_stage, "learn_campaign"),
            "in the second pass": (campaign_stage, "fit_under_campaign"),
            "after all of it": (campaign_stage, "Campaign"),
        }
        with monkeypatch.context() as patch:
            if stop == "before its last file":
                write = campaign_stage.ResultFolder.write_bytes
                patch.setattr(
                    campaign_stage.ResultFolder,
                    "write_bytes",
                    lambda self, name, content: (
                        fail() if name == campaign_stage.ABOUT_FILE else write(self, name, content)
                    ),
                )
            elif stop == "after all of it":
                patch.setattr("bayes_rs.fits.fit_writing._write_exports", fail)
            else:
                patch.setattr(*names[stop], fail)
            with pytest.raises(KeyboardInterrupt):
                brs.fit(records, scan, output=place / "out", **options)
        found = brs.fit(records, scan, output=place / "out", resume=True, **options)
        check_same(one, found)
        assert read_bytes(place / "out") == read_bytes(once[4])

    @pytest.mark.parametrize(
        "name", [*campaign_stage.FILES, "campaign_summary/month=2020-01/part-000001.parquet", "campaign_summary"]
    )
    def test_what_is_lost_is_made_again(self, made, copied, name):
        records, scan, options, one, _ = made
        before = read_bytes(copied)
        lost = copied / name
        for file in [lost] if lost.is_file() else list(lost.rglob("*.parquet")):
            file.unlink()
        check_same(one, brs.fit(records, scan, output=copied, resume=True, **options))
        assert read_bytes(copied) == before

    def test_records_under_another_prior_are_not_kept(self, made, copied, monkeypatch):
        """If the campaign is learnt again and is another one, its records are fitted again."""
        records, scan, options, one, _ = made
        about = json.loads((copied / campaign_stage.ABOUT_FILE).read_text())
        (copied / campaign_stage.ABOUT_FILE).write_text(json.dumps({**about, "prior_key": "another"}))
        (copied / campaign_stage.PRIOR_FILE).unlink()
        fitted = []
        work = campaign_stage.fit_under_campaign
        monkeypatch.setattr(campaign_stage, "fit_under_campaign", lambda *given: fitted.append(1) or work(*given))
        check_same(one, brs.fit(records, scan, output=copied, resume=True, **options))
        assert len(fitted) == 3

    def test_the_summary_on_disk_has_both(self, made, once):
        records, scan, options, one, place = made
        table = pd.read_csv(once[4] / "summary.csv")
        under = one.summary(campaign=True)
        for ours, theirs in (("campaign_mean", "mean"), ("campaign_low", "low"), ("campaign_high", "high")):
            np.testing.assert_allclose(table[ours], under[theirs], rtol=1e-14)  # pandas reads to the last bit but one
        np.testing.assert_allclose(table["mean"], one.summary()["mean"], rtol=1e-14)
        off = brs.fit(records, scan, output=place / "off", **{**options, "campaign": "off"})
        empty = pd.read_csv(place / "off" / "summary.csv")[["campaign_mean", "campaign_low", "campaign_high"]]
        assert empty.isna().all().all()
        assert not list((place / "off").glob("campaign*"))
        assert off.run["campaign"] == {"on": False, "why": ""}

    def test_groups_arrive(self, made):
        records, scan, options, one, place = made
        records = records.assign(stability=("record", np.where(np.arange(N_RECORD) % 2, "stable", "neutral")))
        other = brs.fit(records, scan, **options, campaign_group="stability")
        check_same(other, brs.fit(records, scan, output=place / "out", **options, campaign_group="stability"))
        assert not other.campaign_hyper().equals(one.campaign_hyper())
        assert {"stable", "neutral"} <= set(other.campaign()["bin"])
        assert set(other.campaign_prior().groups) >= {"stable", "neutral"}

    def test_unsteady_records_arrive(self, made):
        records, scan, options, one, _ = made
        flag = np.zeros(N_RECORD, dtype=np.int64)
        flag[3:6] = 1
        marked = records.assign(record_flag=("record", flag, {"flag_meanings": "not_stationary", "flag_masks": [1]}))
        counts = [
            brs.fit(marked, scan, **options, campaign_unsteady=unsteady).run["campaign"]["n_record"]
            for unsteady in (False, True)
        ]
        assert counts == [one.run["campaign"]["n_record"] - 3, one.run["campaign"]["n_record"]]

    def test_a_learnt_prior_from_its_file(self, made):
        records, scan, options, one, place = made
        one.campaign_prior().save(place / "learnt.toml")
        named = {**options, "prior": f"campaign:{place / 'learnt.toml'}", "campaign": "auto"}
        by_object = brs.fit(records, scan, **{**named, "prior": one.campaign_prior()})
        by_name = brs.fit(records, scan, **named)
        in_folder = brs.fit(records, scan, output=place / "out", **named)
        for other in (by_name, in_folder):
            for name in by_object.source.datasets:
                pd.testing.assert_frame_equal(other.table(name), by_object.table(name), check_exact=True)
        assert not by_name.has_campaign
        assert not by_name.summary().equals(one.summary())
        (place / "learnt.toml").unlink()  # the folder keeps it
        again = brs.fit_files(Settings.load(place / "out" / "run.json").changed(output=str(place / "again")))
        pd.testing.assert_frame_equal(again.summary(), by_name.summary(), check_exact=True)

    def test_a_settings_file_names_a_prior_beside_it(self, made, monkeypatch):
        records, scan, options, one, place = made
        (place / "conf").mkdir()
        one.campaign_prior().save(place / "conf" / "learnt.toml")
        records.to_netcdf(place / "conf" / "records.nc", engine="h5netcdf")
        options["noise"].save(place / "conf" / "noise.nc")
        (place / "conf" / "settings.toml").write_text(
            f"scan.scan = '{scan.name}'\nfiles.files = ['records.nc']\nnoise.noise = 'noise.nc'\n"
            "fit.prior = 'campaign:learnt.toml'\nfit.seed = 3\nfit.target_ess = 100\n"
        )
        for where, settings in ((place, "conf/settings.toml"), (place / "conf", "settings.toml")):
            monkeypatch.chdir(where)
            found = Settings.load(settings)
            assert Path(found.fit.prior.removeprefix("campaign:")) == place / "conf" / "learnt.toml"
            assert str(place / "conf" / "learnt.toml") in found.input_files()


@pytest.fixture(scope="module")
def found(once):
    return brs.open_fit(once[4])


@pytest.mark.slow
class TestWhatIsSaid:
    def test_the_table(self, found):
        table = found.campaign()
        names = ["quantity", "bin", "mean", "low", "high", "prob", "interval", "n_record", "decided"]
        assert list(table.columns) == names
        first = table["bin"] == "all"
        assert first.iloc[0]
        assert not first[first.to_numpy().argmin() :].any(), "the rows of all records come first"
        assert set(STRESSES) | {"ti", "ti_p90", "tke"} <= set(table[first]["quantity"])
        known = table.dropna(subset=["low"])
        assert (known["low"] <= known["mean"]).all()
        assert (known["mean"] <= known["high"]).all()
        assert len(speed_bins(table, "ti")) >= 1

    def test_hyperparameters(self, found):
        names = "name mean low high prior_mean prior_low prior_high interval decided ess r_hat"
        assert list(found.campaign_hyper().columns) == names.split()

    def test_at_most_three_lines(self, found):
        assert campaign_words(found.run["campaign"], found.campaign()) == found.words[-3:]
        assert not any("campaign" in line for line in found.words[:-3])

    def test_chains_that_fall_short_are_a_failure(self, found):
        about = {**found.run["campaign"], "converged": False, "r_hat": 1.3}
        (line,) = campaign_failures(about)
        assert "1.30" in line
        assert campaign_failures({**about, "converged": True}) == []
        assert campaign_failures({"on": False, "why": "few"}) == []

    def test_the_average_of_the_records_means(self, found):
        table = found.summary()
        for index, name in enumerate(STRESSES):
            assert record_means(found)[index] == pytest.approx(table[table["stress"] == name]["mean"].mean(), rel=1e-12)

    def test_the_picture_shows_the_tables(self, found):
        figure = brs.plot.campaign(found)
        means, intensity, hyper = figure.axes[:3]
        table = found.campaign()
        middle = table[(table["bin"] == "all")].set_index("quantity")["mean"].loc[list(STRESSES)]
        drawn = [line.get_ydata() for line in means.get_lines() if len(line.get_ydata()) == len(STRESSES)]
        marks = np.concatenate([bars.lines[0].get_ydata() for bars in means.containers if hasattr(bars, "lines")])
        assert sorted(marks) == sorted(middle)
        assert any(np.allclose(values, record_means(found)) for values in drawn)
        expected = speed_bins(table, "ti_p90")["mean"]
        assert any(np.array_equal(line.get_ydata(), expected) for line in intensity.get_lines())
        assert [label.get_text() for label in hyper.get_yticklabels()] == found.campaign_hyper()["name"].tolist()
        figure.savefig(io.BytesIO())

    def test_the_report_has_a_section(self, found, tmp_path):
        page = brs.write_report(found, tmp_path / "a.html").read_text(encoding="utf-8")
        assert '<section id="campaign"' in page
        assert f"Campaign of {N_RECORD - 1} records" in page
        for kind in ("means", "speed", "hyper"):
            assert f'data-figure="campaign-{kind}"' in page
        assert brs.write_report(found, tmp_path / "b.html").read_text(encoding="utf-8") == page

    def test_without_one_the_report_says_why(self, tmp_path):
        records, scan, noise = scene(3)
        few = brs.fit(records, scan, noise=noise, **SMALL)
        why = f"3 of 3 records can enter (fitted, steady, not flagged), and it begins at {CAMPAIGN_FROM}"
        assert few.words[-1] == f"no campaign: {why}"
        assert f"There is no campaign: {why}." in brs.write_report(few, tmp_path / "a.html").read_text(encoding="utf-8")
        off = brs.fit(records, scan, noise=noise, campaign="off", **SMALL)
        assert not any("campaign" in line for line in off.words)
        assert 'id="campaign"' not in brs.write_report(off, tmp_path / "b.html").read_text(encoding="utf-8")
        for fit in (few, off):
            for ask in (fit.campaign, fit.campaign_hyper, fit.campaign_prior, lambda: fit.summary(campaign=True)):  # noqa: B023
                with pytest.raises(InputError, match="no campaign"):
                    ask()

    @pytest.mark.parametrize(
        "asked", [{"prob": 0.5}, {"interval": "highest-density"}, {"derived": ("tke",)}, {"frame": "lidar"}]
    )
    def test_other_summaries_need_draws_that_are_not_kept(self, found, asked):
        with pytest.raises(InputError, match="no draws are kept"):
            found.summary(campaign=True, **asked)
