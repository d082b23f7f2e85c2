"""The summary: columns, numbers against ArviZ and a slow computation of each record, derived quantities."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import STRESSES, Fit, InputError, fit, load_scan
from bayes_rs.fits.fit_data import MemoryTables
from bayes_rs.fits.flags import FLAGS
from bayes_rs.fits.summarizing import COLUMNS
from bayes_rs.geometry.stress import pack_stress, rotate_stress
from bayes_rs.priors.ratio import WeakPrior

DERIVED = ("ti", "tke", "friction_velocity", "anisotropy_2", "anisotropy_3")


@pytest.fixture(scope="module")
def result():
    """Four records of six beams: 0 and 3 as they should be, 1 without a beam, 2 with one beam fewer."""
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    rng = np.random.default_rng(21)
    records = records_of(draw_variances(WeakPrior().draw(4, rng), scan, noise, rng), scan)
    records["wind_speed"][:] = [10.0, 8.0, 12.0, 5.0]
    records["flag"][1] = 1
    records["flag"][2, 4] = 2
    return fit(records, scan, noise=noise, seed=1, target_ess=200)


@dataclass(frozen=True)
class ByHand:
    """Records, and draws of the weak prior."""

    wind_speed: np.ndarray

    def records(self):
        return xr.Dataset({"wind_speed": ("record", self.wind_speed)})

    def prior_draws(self):
        return WeakPrior().draw(50, 1)


def fit_of(stress, *, wind_speed=10.0):
    """A fit by hand: stress (record, 6), jittered by a millionth because constant chains have no diagnostics."""
    stress = np.asarray(stress, dtype=float)
    n_record, (n_chain, n_draw) = len(stress), (4, 16)
    rng = np.random.default_rng(22)
    size = 1.0 + 1e-6 * rng.standard_normal((n_record, n_chain * n_draw, 1))  # of the whole tensor: its shape is exact
    number = np.arange(n_record)
    draws = pd.DataFrame((size * stress[:, None]).reshape(-1, 6), columns=list(STRESSES))
    tables = {
        "draws": draws.assign(record=np.repeat(number, n_chain * n_draw)),
        "posterior": pd.DataFrame({"record": number, "time": np.datetime64("NaT", "ns"), "flag_bits": 0}).assign(
            n_draw=float(n_chain * n_draw)
        ),
        "summary": pd.DataFrame(
            {"record": np.repeat(number, 6), "stress": [*STRESSES] * n_record, "ess_bulk": 1.0, "ess_tail": 1.0}
        ).assign(r_hat=1.0, decided=0.5, least_squares=np.nan, least_squares_se=np.nan),
    }
    run = {
        "n_record": n_record,
        "n_chain": n_chain,
        "n_draw": n_draw,
        "settings": {"fit": {"prob": 0.9, "interval": "equal-tailed", "derived": ["tke"]}},
    }
    return Fit(run, load_scan("staring"), MemoryTables({}).with_tables(tables), ByHand(np.full(n_record, wind_speed)))


def mean_of(stress, name, **options):
    table = fit_of(stress, **options).summary(derived=[name], prob=0.5)
    return table[table["stress"] == name]["mean"].to_numpy()


class TestTable:
    def test_columns_and_their_order(self, result):
        expected = (
            "record time stress mean sd median low high prob interval decided least_squares least_squares_se "
            "mcse_mean mcse_sd mcse_median mcse_low mcse_high ess_bulk ess_tail r_hat flag"
        )
        assert expected.split() == list(COLUMNS)
        assert list(result.summary().columns) == list(COLUMNS)

    def test_rows_are_records_times_stresses_in_their_order(self, result):
        table = result.summary(derived=["tke", "ti"])
        names = [*STRESSES, "tke", "ti"]
        assert table["stress"].tolist() == names * 4
        assert table["record"].tolist() == np.repeat(np.arange(4), len(names)).tolist()
        start = np.datetime64("2020-01-01", "ns") + np.arange(4) * np.timedelta64(600, "s")
        np.testing.assert_array_equal(table["time"].to_numpy(), np.repeat(start, len(names)))

    def test_flags_are_in_words_on_every_row_of_a_record(self, result):
        table = result.summary()
        flags = table.groupby("record")["flag"].agg(lambda words: sorted(set(words)))
        assert flags.tolist() == [[""], ["no_usable_beam"], ["beam_left_out;outside_noise"], ["outside_noise"]]

    def test_records_that_were_not_fitted_are_rows_of_nan(self, result):
        table = result.summary(derived=DERIVED)
        numbers = [name for name in COLUMNS if name not in ("record", "time", "stress", "prob", "interval", "flag")]
        missing = table[numbers].isna().groupby(table["record"]).all().all(axis=1)
        assert missing.tolist() == [False, True, False, False]
        stresses = table[table["stress"].isin(STRESSES) & (table["record"] != 1)]
        seen = [name for name in numbers if not name.startswith("least_squares")]
        assert not stresses[seen].isna().any(axis=None)

    def test_a_result_without_times_has_no_time(self):
        assert fit_of([[1.0, 0.6, 0.4, 0.1, -0.2, 0.0]]).summary(derived=())["time"].isna().all()

    def test_more_records_than_one_batch_come_out_in_order(self):
        uu = 1.0 + np.arange(300.0)  # the batch is 256
        table = fit_of(np.outer(uu, [1.0, 0.6, 0.4, 0.1, -0.2, 0.0])).summary(derived=())
        np.testing.assert_allclose(table[table["stress"] == "uu"]["mean"], uu, rtol=1e-6)  # the jitter's mean

    def test_parts_in_memory_are_joined_when_their_table_is_read(self):
        draws = [pd.DataFrame({"record": [first, first + 1], "uu": [1.0, 2.0]}) for first in (0, 2)]
        tables = MemoryTables({"summary": [draws[0]], "draws": list(draws)})
        assert tables.read("summary") is draws[0]
        assert len(tables.parts["draws"]) == 2
        whole = tables.read("draws", records=np.array([1, 2]))
        assert whole["record"].tolist() == [1, 2]
        assert whole.index.tolist() == [1, 2]
        assert len(tables.parts["draws"]) == 1


class TestNumbers:
    def test_moments_are_those_of_each_record_on_its_own(self, result):
        table = result.summary().set_index(["record", "stress"])
        for record in (0, 2, 3):
            for name in STRESSES:
                draws = result["posterior/stress"].sel(record=record, component=name).values.ravel()
                row = table.loc[(record, name)]
                assert row["mean"] == pytest.approx(np.mean(draws), rel=1e-12)  # rounding, here and below
                assert row["sd"] == pytest.approx(np.std(draws, ddof=1), rel=1e-12)
                assert row["median"] == pytest.approx(np.median(draws), rel=1e-12)

    @pytest.mark.parametrize("prob", [0.5, 0.9, 0.95])
    def test_intervals_have_equal_tails(self, result, prob):
        table = result.summary(prob=prob).set_index(["record", "stress"])
        assert set(table["prob"]) == {prob}
        for record in (0, 2, 3):
            for name in STRESSES:
                draws = result["posterior/stress"].sel(record=record, component=name).values.ravel()
                row = table.loc[(record, name)]
                ends = np.quantile(draws, [0.5 - 0.5 * prob, 0.5 + 0.5 * prob])
                np.testing.assert_allclose(row[["low", "high"]].astype(float), ends, rtol=1e-12)

    def test_diagnostics_are_those_in_sample_stats(self, result):
        table = result.summary()
        for name in ("ess_bulk", "ess_tail", "r_hat"):
            expected = result["sample_stats"][name].transpose("record", "component").values
            np.testing.assert_allclose(table[name].to_numpy().reshape(4, 6), expected, rtol=1e-12)

    def test_diagnostics_of_derived_quantities_are_those_of_arviz(self, result, arviz):
        stress = result["posterior/stress"].sel(record=3)
        tke = 0.5 * stress.sel(component=["uu", "vv", "ww"]).sum("component").transpose("chain", "draw").values
        table = result.summary(derived=["tke"]).set_index(["record", "stress"])
        row = table.loc[(3, "tke")]
        assert row["mean"] == pytest.approx(tke.mean(), rel=1e-12)
        assert row["ess_bulk"] == pytest.approx(arviz.ess(tke, method="bulk"), rel=1e-10)
        assert row["ess_tail"] == pytest.approx(arviz.ess(tke, method="tail", prob=(0.05, 0.95)), rel=1e-10)


class TestDerivedQuantities:
    """Closed forms; tolerance: the hand-made result's jitter of a millionth."""

    SOME = ((1.8, 0.9, 0.5, 0.1, -0.4, 0.3), (4.0, 2.0, 1.0, 0.0, 0.0, 0.0))

    def test_kinetic_energy_is_half_the_trace(self):
        np.testing.assert_allclose(mean_of(self.SOME, "tke"), [1.6, 3.5], rtol=1e-6)

    def test_friction_velocity_takes_both_components_of_the_stress(self):
        """u* = ((−0.4)² + 0.3²)^(1/4) = 0.5^(1/2)."""
        np.testing.assert_allclose(mean_of(self.SOME, "friction_velocity"), [np.sqrt(0.5), 0.0], rtol=1e-6)

    def test_turbulence_intensity_is_sigma_u_over_the_wind_speed(self):
        np.testing.assert_allclose(mean_of(self.SOME, "ti", wind_speed=8.0), [np.sqrt(1.8) / 8.0, 0.25], rtol=1e-6)

    def test_turbulence_intensity_uses_the_wind_speed_of_its_own_record(self, result):
        table = result.summary(derived=["ti"])
        rows = table[table["stress"] == "ti"].set_index("record")["mean"]
        for record, speed in ((0, 10.0), (2, 12.0), (3, 5.0)):
            uu = result["posterior/stress"].sel(record=record, component="uu").values
            assert rows[record] == pytest.approx(np.mean(np.sqrt(uu)) / speed, rel=1e-12)

    @pytest.mark.parametrize(
        ("eigenvalues", "second", "third"),
        [
            ((1.0, 1.0, 1.0), 0.0, 0.0),
            # shares 1, 0, 0: deviations 2/3, −1/3, −1/3
            ((1.0, 0.0, 0.0), 4 / 9 + 2 / 9, 8 / 27 - 2 / 27),
            # shares 1/2, 1/2, 0: deviations 1/6, 1/6, −1/3
            ((1.0, 1.0, 0.0), 2 / 36 + 1 / 9, 2 / 216 - 1 / 27),
        ],
        ids=["isotropic", "one component", "two components"],
    )
    def test_invariants_at_the_corners_of_the_realizable_triangle(self, eigenvalues, second, third):
        """At the corners, and in whatever frame and size the tensor is written."""
        turn = np.linalg.qr(np.random.default_rng(23).normal(size=(3, 3)))[0]
        plain = pack_stress(np.diag(eigenvalues))
        stress = [plain, 2.5 * rotate_stress(plain, turn)]
        np.testing.assert_allclose(mean_of(stress, "anisotropy_2"), second, atol=1e-12)  # eigenvalues to rounding
        np.testing.assert_allclose(mean_of(stress, "anisotropy_3"), third, atol=1e-12)

    def test_invariants_are_traces_of_powers_of_the_anisotropy_tensor(self):
        tensor = np.array([[1.8, 0.1, -0.4], [0.1, 0.9, 0.3], [-0.4, 0.3, 0.5]])
        b = tensor / np.trace(tensor) - np.eye(3) / 3.0
        assert mean_of([self.SOME[0]], "anisotropy_2")[0] == pytest.approx(np.trace(b @ b), rel=1e-12)
        assert mean_of([self.SOME[0]], "anisotropy_3")[0] == pytest.approx(np.trace(b @ b @ b), rel=1e-12)


class TestRefusals:
    @pytest.mark.parametrize("prob", [0.0, 1.0, -0.1, 90.0, float("nan")])
    def test_prob_that_is_no_probability(self, result, prob):
        with pytest.raises(InputError, match=rf"Invalid prob {prob}: it must be between 0 and 1\."):
            result.summary(prob=prob)

    def test_a_derived_quantity_that_is_not_known(self, result):
        message = r"Unknown derived quantity 'mood': it must be one of ti, ti_v, ti_w, tke, friction_velocity, anis"
        with pytest.raises(InputError, match=message):
            result.summary(derived=["tke", "mood"])


def test_flags_of_the_test_scene_are_what_the_fit_says(result):
    outside = FLAGS["outside_noise"]  # winds of 12 and 5 m/s, and noise of 10 m/s
    expected = [0, FLAGS["no_usable_beam"], FLAGS["beam_left_out"] | outside, outside]
    assert result["sample_stats/flag"].values.tolist() == expected
