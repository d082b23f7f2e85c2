"""The result: its layout, its file, ArviZ, and what it refuses."""

import json

import numpy as np
import pytest
import xarray as xr
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import STRESSES, InputError, fit, load_scan
from bayes_rs.fits.columns import N_PRIOR_DRAW
from bayes_rs.fits.flags import FLAGS, flag_words
from bayes_rs.priors.ratio import WeakPrior


def iter_once(fit):
    """Take the first of what a loop over a fit would give."""
    return next(iter(fit))


@pytest.fixture(scope="module")
def scene():
    """Three records: 0 as it should be, 1 without a beam, 2 with one beam fewer."""
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    rng = np.random.default_rng(31)
    records = records_of(draw_variances(WeakPrior().draw(3, rng), scan, noise, rng), scan, yaw_deg=4.0)
    records["flag"][1] = 1
    records["flag"][2, 4] = 2
    return scan, noise, records


@pytest.fixture(scope="module")
def result(scene):
    scan, noise, records = scene
    return fit(records, scan, noise=noise, seed=7, target_ess=200)


@pytest.fixture(scope="module")
def file(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "posterior.nc"
    result.to_datatree().to_netcdf(path, engine="h5netcdf")
    return path


class TestLayout:
    def test_groups(self, result):
        assert set(result.to_datatree().children) == {
            "posterior",
            "prior",
            "posterior_predictive",
            "observed_data",
            "sample_stats",
            "log_likelihood",
        }

    @pytest.mark.parametrize(
        ("variable", "dims"),
        [
            ("posterior/stress", ("chain", "draw", "record", "component")),
            ("prior/stress", ("chain", "draw", "component")),
            ("posterior_predictive/variance", ("chain", "draw", "record", "beam")),
            ("observed_data/variance", ("record", "beam")),
            ("observed_data/used", ("record", "beam")),
            ("observed_data/wind_speed", ("record",)),
            ("observed_data/yaw", ("record",)),
            ("sample_stats/ess_bulk", ("record", "component")),
            ("sample_stats/r_hat", ("record", "component")),
            ("sample_stats/flag", ("record",)),
        ],
    )
    def test_dims(self, result, variable, dims):
        assert result[variable].dims == dims

    def test_components_are_the_six_stresses_in_their_order(self, result):
        for name in ("posterior", "prior", "sample_stats"):
            assert result[name].coords["component"].values.tolist() == list(STRESSES)

    def test_records_keep_their_start_and_beams_their_number(self, result, scene):
        _, _, records = scene
        for name in ("posterior", "posterior_predictive", "observed_data", "sample_stats"):
            np.testing.assert_array_equal(result[name].coords["time"], records["time"])
        np.testing.assert_array_equal(result["observed_data"].coords["beam"], records["beam"])

    def test_what_was_observed_is_in_it(self, result, scene):
        _, _, records = scene
        for name in ("variance", "wind_speed", "yaw"):
            np.testing.assert_array_equal(result["observed_data"][name], records[name])
        assert result["observed_data/used"].values.tolist() == [[1] * 6, [0] * 6, [1, 1, 1, 1, 0, 1]]

    def test_chains_say_which_ensemble_they_belong_to(self, result):
        ensemble = result["posterior"].coords["ensemble"].values
        assert np.bincount(ensemble).tolist() == [8, 8, 8, 8]
        assert np.all(np.diff(ensemble) >= 0)

    def test_predictions_are_missing_where_a_record_does_not_use_the_beam(self, result):
        missing = result["posterior_predictive/variance"].isnull()
        used = result["observed_data/used"] == 1
        assert bool((missing.all(("chain", "draw")) == ~used).all())
        assert bool((missing.any(("chain", "draw")) == ~used).all())

    def test_draws_of_the_prior_are_enough_for_its_outline(self, result):
        draws = result["prior/stress"]
        assert draws.sizes == {"chain": 1, "draw": N_PRIOR_DRAW, "component": 6}
        # ln uu has mean 0 and standard deviation 2: four standard errors of the mean of 10 000 draws
        assert float(np.log(draws.sel(component="uu")).mean()) == pytest.approx(0.0, abs=4.0 * 2.0 / 100.0)

    def test_units_are_written(self, result):
        for name in ("posterior/stress", "prior/stress", "observed_data/variance"):
            assert result[name].attrs["units"] == "m2 s-2"

    def test_attributes_say_what_was_done(self, result, scene):
        scan, own, _ = scene
        wanted = {
            "target": "record",
            "sampler": "emcee",
            "seed": 7,
            "target_ess": 200,
            "scan": "6-beam",
            "scan_key": scan.key,
            "sight": "sees all six stresses",
            "prior": WeakPrior().in_words(),
            "prior_name": "weak",
        }
        assert {key: result.attrs[key] for key in wanted} == wanted
        assert result.attrs["created_by"].startswith("bayes_rs ")
        noise = json.loads(result.attrs["noise"])
        assert noise == {
            "method": "given",
            "turbulence": "test",
            "length_scales": [own.turbulence.length_scale],
            "gammas": [own.turbulence.gamma],
            "duration": 600.0,
            "wind_speeds": [10.0],
            "yaws_deg": [0.0],
            "n_realizations": None,
        }

    def test_a_result_with_no_fitted_record_has_the_same_layout(self, scene):
        scan, noise, records = scene
        nothing = records.copy(deep=True)
        nothing["flag"][:] = 1
        tree = fit(nothing, scan, noise=noise, seed=1)
        assert tree["posterior/stress"].dims == ("chain", "draw", "record", "component")
        assert bool(tree["posterior/stress"].isnull().all())
        assert tree["sample_stats/flag"].values.tolist() == [FLAGS["no_usable_beam"]] * 3


class TestFile:
    def test_the_file_gives_the_same_result_back(self, result, file):
        with xr.open_datatree(file, engine="h5netcdf") as back:
            assert back.load().identical(result.to_datatree())

    def test_group_is_a_dataset_of_one_group(self, result):
        assert isinstance(result["posterior"], xr.Dataset)
        assert result["posterior"].identical(result.to_datatree()["posterior"].to_dataset())

    def test_arviz_opens_the_file_as_it_is(self, result, file, arviz):
        opened = arviz.from_netcdf(file)
        # InferenceData before ArviZ 1.0, a DataTree since
        groups = opened.children if isinstance(opened, xr.DataTree) else opened.groups()
        assert set(groups) == set(result.to_datatree().children)
        xr.testing.assert_equal(opened.posterior["stress"], result["posterior/stress"])

    def test_arviz_summarizes_a_record_to_our_numbers(self, result, file, arviz):
        opened = arviz.from_netcdf(file)
        table = arviz.summary(opened.posterior.isel(record=2), round_to="none")
        assert table.index.tolist() == [f"stress[{name}]" for name in STRESSES]
        ours = result["sample_stats/ess_bulk"].sel(record=2).values
        # ours is of walkers, ArviZ's of chains in which walkers of four steps lie end to end
        np.testing.assert_allclose(table["ess_bulk"], ours, rtol=0.3)
        draws = result["posterior/stress"].sel(record=2)
        np.testing.assert_allclose(table["mean"], draws.mean(("chain", "draw")), rtol=1e-12)


class TestRefusals:
    def test_a_group_that_is_not_there(self, result):
        with pytest.raises(
            InputError, match="Unknown group 'likelihood' of a fit: it must be one of posterior, sample"
        ):
            result["likelihood"]
        assert "likelihood" not in result
        with pytest.raises(
            InputError, match=r"^Unknown variable 'nope' of the group 'prior' of a fit: it must be one of s"
        ):
            result["prior/nope"]

    @pytest.mark.parametrize("ask", [lambda fit: fit[0], lambda fit: fit[1:], lambda fit: fit[None], list, iter_once])
    def test_a_fit_is_no_sequence_of_records_and_says_so(self, result, ask):
        with pytest.raises(
            InputError, match=r"^Invalid group .* of a fit: give its name, one of posterior, .*; a fit is no"
        ):
            ask(result)

    def test_draws_that_were_not_kept(self, scene):
        scan, noise, records = scene
        short = fit(records, scan, noise=noise, seed=7, target_ess=200, draws="none")
        words = r"The fit kept no draws, which this needs: fit again with draws='float32' \(--draws float32\)\."
        for needs in (
            short.to_arviz,
            short.to_datatree,
            short.draws,
            short.predicted_draws,
            short.lidar_frame,
            lambda: list(short.batches()),
            lambda: short["posterior"],
            lambda: short["posterior_predictive/variance"],
            lambda: short.table("draws"),
            lambda: short.summary(prob=0.5),
            lambda: short.summary(derived=["tke"]),
            lambda: short.summary(frame="lidar"),
        ):
            with pytest.raises(InputError, match=words):
                needs()
        assert "posterior" not in short
        assert "sample_stats" in short

    def test_a_table_that_is_not_there(self, result):
        with pytest.raises(InputError, match="No table 'chains' of this fit: it has summary, posterior, draws, pred"):
            result.table("chains")

    def test_a_nuisance_that_was_not_sampled(self, result):
        with pytest.raises(InputError, match="No nuisance 'yaw_error' was sampled: those of this fit are none"):
            result.nuisance_draws("yaw_error")


class TestFlags:
    def test_flags_are_different_bits(self):
        bits = list(FLAGS.values())
        assert sum(bits) == np.bitwise_or.reduce(bits)
        assert [bit.bit_count() for bit in bits] == [1] * len(bits)

    def test_nothing_wrong_is_an_empty_text(self):
        assert flag_words(0) == ""

    @pytest.mark.parametrize("word", list(FLAGS))
    def test_each_bit_has_its_word(self, word):
        assert flag_words(FLAGS[word]) == word

    def test_several_are_joined(self):
        assert flag_words(np.int64(FLAGS["ensembles_differ"] | FLAGS["no_wind"])) == "no_wind;ensembles_differ"

    def test_the_file_says_what_the_bits_mean(self, result):
        attributes = result["sample_stats/flag"].attrs
        meanings = dict(zip(attributes["flag_meanings"].split(), attributes["flag_masks"], strict=True))
        assert meanings == FLAGS
