"""The uncertainty budget: a linear, Gaussian case in closed form, its laws, and the picture and the command."""

import sys
from functools import partial

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import STRESSES, InputError, Nuisances, budget, cli, load_scan
from bayes_rs.fits.budget import budget_of_records
from bayes_rs.fits.budget_table import budget_lines
from bayes_rs.geometry.forward import radial_variance
from bayes_rs.noise.noise import Noise
from bayes_rs.noise.probe_length import probe_slope
from bayes_rs.priors import GaussianPrior
from bayes_rs.priors.ratio import WeakPrior

fit = partial(brs.fit, campaign="off", sampler="direct", seed=1)
WIDE = "6-beam@opening_angle_deg=45"


def scene(name=WIDE, n_record=6, *, relative_variance=0.06, seed=1):
    scan = load_scan(name)
    noise, rng = plain_noise(scan, relative_variance=relative_variance), np.random.default_rng(seed)
    return records_of(draw_variances(WeakPrior(log_sd_uu=0.3).draw(n_record, rng), scan, noise, rng), scan), scan, noise


def column(table, name="share"):
    """A column as a frame: sources by stresses, in the table's order."""
    frame = table.pivot(index="source", columns="stress", values=name)
    return frame.loc[list(dict.fromkeys(table["source"])), list(dict.fromkeys(table["stress"]))]


class TestClosedForm:
    """Noise and prior so narrow that the model is linear and Gaussian: the budget by matrices, without a draw."""

    CENTRE = np.array([1.0, 0.6, 0.4, 0.05, -0.2, 0.03])
    UNCERTAIN = Nuisances(yaw_sd_deg=0.6, tilt_sd_deg=0.4, instrument_noise_log_sd=0.3, probe_length_log_sd=0.05)
    OFFSET, SCATTER, NOISE = 0.02, (3e-5, 1e-5), 4e-5

    def linear(self, noise):
        """The budget of u by the Jacobian of ln E[y] at the centre, in which nuisances are true errors of the scan."""

        def log_expected(x):
            at = load_scan(f"{WIDE},probe=zx-300", yaw_deg=float(x[6]), tilt_deg=float(x[7]))
            return np.log(radial_variance(at, x[:6]) + self.OFFSET * np.exp(x[8]))

        sd = np.array([self.UNCERTAIN.yaw_sd_deg, self.UNCERTAIN.tilt_sd_deg, self.UNCERTAIN.instrument_noise_log_sd])
        x, step = np.concatenate([self.CENTRE, np.zeros(3)]), 1e-4
        moved = [log_expected(x + step * one) - log_expected(x - step * one) for one in np.eye(9)]
        jacobian = np.stack(moved, axis=-1) / (2.0 * step)
        jacobian[:, 6:] *= sd
        theory = np.log1p(noise.covariance[0])
        common, own = np.log1p(self.SCATTER)
        scatter = common * np.ones((6, 6)) + own * np.eye(6)
        slope = self.UNCERTAIN.probe_length_log_sd * probe_slope(noise, [10.0], [0.0], None)[0]
        probe = np.outer(slope, slope)
        inverse_prior = np.zeros((9, 9))
        inverse_prior[:6, :6] = np.linalg.inv(self.prior_covariance())
        inverse_prior[6:, 6:] = np.eye(3)

        def variance(covariance, columns):
            own = jacobian[:, columns]
            precision = own.T @ np.linalg.solve(covariance, own) + inverse_prior[np.ix_(columns, columns)]
            return np.linalg.inv(precision)

        every = list(range(9))
        whole = variance(theory + scatter + probe, every)
        least = variance(theory, every[:6])
        without = {
            "scatter beyond theory": (theory + probe, every),
            "probe length": (theory + scatter, every),
            "yaw": (theory + scatter + probe, [i for i in every if i != 6]),
            "tilt": (theory + scatter + probe, [i for i in every if i != 7]),
            "instrument noise": (theory + scatter + probe, [i for i in every if i != 8]),
        }
        found = {name: np.diag(whole)[:6] - np.diag(variance(*case))[:6] for name, case in without.items()}
        gain = least @ jacobian[:, :6].T @ np.linalg.inv(theory)  # of the estimate on the data, and on the prior
        lean = least @ inverse_prior[:6, :6]
        found["sampling"] = np.diag(gain @ theory @ gain.T)
        found["prior"] = np.diag(lean @ self.prior_covariance() @ lean.T)
        found["combined"] = np.diag(whole)[:6]
        found["rest"] = found["combined"] - sum(value for name, value in found.items() if name != "combined")
        return pd.DataFrame(found, index=list(STRESSES)).T

    @staticmethod
    def prior_covariance():
        sd = 0.012 * np.array([1.0, 0.7, 0.6, 0.5, 0.5, 0.4])
        return np.outer(sd, sd) * (0.3 + 0.7 * np.eye(6))

    @pytest.fixture(scope="class")
    @classmethod
    def both(cls):
        scan = load_scan(f"{WIDE},probe=zx-300")
        noise = plain_noise(scan, relative_variance=cls.NOISE)
        # every beam has a part of its own besides, so that no combination is known without error
        noise = Noise(**{
            **{name: getattr(noise, name) for name in ("bias", "gain", "beam", "scan_name", "scan_geometry")},
            **{name: getattr(noise, name) for name in ("wind_speed", "yaw", "duration", "turbulence", "method")},
            "covariance": noise.covariance + 0.5 * cls.NOISE * np.eye(6),
        })  # fmt: skip
        records = records_of(radial_variance(scan, cls.CENTRE)[None] + cls.OFFSET, scan).assign(
            variance_scatter=("record", [cls.SCATTER[0]]), variance_scatter_of_beams=("record", [cls.SCATTER[1]])
        )
        options = {"prior": GaussianPrior(cls.CENTRE, cls.prior_covariance()), "instrument_noise": cls.OFFSET}
        found = fit(records, scan, noise=noise, nuisances=cls.UNCERTAIN, unsteady_level=0.0, **options)
        table = budget(found, n_draw=65536)
        return table, cls().linear(noise)

    def test_every_part_is_that_of_the_matrices(self, both):
        table, linear = both
        found = column(table, "variance")
        assert set(found.index) == set(linear.index)
        whole = linear.loc["combined"]
        assert (linear.drop("combined").max(axis=1) / whole.max() > 0.003).sum() >= 6  # the case has power
        # 0.005 of Monte-Carlo error, three of them; errors of 1 % of uu bend the model by less than that
        np.testing.assert_allclose(found.loc[linear.index] / whole, linear / whole, atol=0.015)

    def test_both_first_order_parts_are_all_that_is_left_when_all_is_known(self, both):
        first_order = both[0].attrs["first_order"]
        np.testing.assert_allclose([first_order[name] for name in STRESSES], 1.0, atol=0.015)

    def test_the_combined_uncertainty_is_gaussian(self, both):
        last = both[0][both[0]["source"] == "combined"]
        np.testing.assert_allclose(last["expanded"] / last["u"], 1.644854, rtol=0.015)  # of 65536 draws


class TestLaws:
    def test_without_nuisances_all_is_sampling_and_prior(self):
        records, scan, noise = scene()
        table = budget(fit(records, scan, noise=noise))
        share = column(table)
        assert share.index.tolist() == ["sampling", "prior", "rest", "combined"]
        np.testing.assert_allclose(share.loc["rest"], 0.0, atol=1e-12)
        np.testing.assert_allclose(share.loc["sampling"] + share.loc["prior"], 1.0, rtol=1e-12)
        assert table.attrs["left_out"][0] == "scatter beyond theory"
        kind = table.drop_duplicates("source").set_index("source")["type"].to_dict()
        assert kind == {"sampling": "A", "prior": "B", "rest": "", "combined": ""}

    def test_shares_sum_to_one_with_the_rest_and_none_is_cut_off(self):
        records, scan, noise = scene("6-beam")
        uncertain = {"yaw_sd_deg": 5.0, "tilt_sd_deg": 2.0, "vertical_gradient_sd": 0.5, "inflation_dof": 5.0}
        share = column(budget(fit(records, scan, noise=noise), **uncertain))
        np.testing.assert_allclose(share.drop("combined").sum(), 1.0, rtol=1e-12)
        assert (share.to_numpy() < 0.0).any()
        u = column(budget(fit(records, scan, noise=noise), **uncertain), "u")
        assert ((u < 0.0) == (share < 0.0)).all().all()

    def test_what_no_beam_sees_is_the_priors(self):
        """A staring beam with next to no noise: the data's errors are gone, and what is left of vv and ww is prior."""
        records, scan, noise = scene("staring", relative_variance=1e-4)
        table = budget(fit(records, scan, noise=noise))
        share = column(table)
        assert share.loc["sampling", "uu"] > 0.98
        assert (share.loc["prior", ["vv", "ww", "uv", "uw", "vw"]] > 0.98).all()
        assert (column(table, "decided").loc["combined", ["vv", "ww"]] < 0.1).all()

    def test_a_level_that_is_uncertain_is_sampling_in_what_the_prior_makes_of_it(self):
        records, scan, noise = scene("staring", relative_variance=0.06)
        table = column(budget(fit(records, scan, noise=noise)))
        # ln vv = ln uu + ln vv/uu: variances of about 0.06 and of the prior's ratio, 0.5²
        assert table.loc["sampling", "vv"] == pytest.approx(0.06 / (0.06 + 0.25), abs=0.06)

    @pytest.mark.parametrize("nuisance", [{"yaw_sd_deg": 8.0}, {"inflation_dof": 4.0}, {"vertical_gradient_sd": 0.6}])
    def test_a_switched_source_is_what_two_fits_differ_by(self, nuisance):
        records, scan, noise = scene(WIDE, 40)
        options = {"noise": noise, "target_ess": 4000}
        with_it = fit(records, scan, nuisances=Nuisances(**nuisance), **options)
        one, other = (np.einsum("rkk->k", f.covariance()) / 40 for f in (with_it, fit(records, scan, **options)))
        table = budget(with_it)
        variance = column(table, "variance")
        source = variance.index[1]
        # variances of 40 · 4000 draws, of tails that are not normal
        np.testing.assert_allclose(variance.loc["combined"], one, rtol=0.03)
        np.testing.assert_allclose(variance.loc[source] / one, (one - other) / one, atol=0.03)

    def test_the_length_scale_counts_on_both_ways(self):
        scan = load_scan("6-beam")
        records = brs.make_records(brs.simulate(scan, "fu-2022", wind_speed=10.0, n_records=3, seed=1), scan)
        found = fit(records, scan)
        share = [
            column(budget(found, **given)).loc["length scale", "uu"]
            for given in ({}, *({"length_scale_log_sd": sd, "length_scale": 90.0} for sd in (0.1, 0.6)))
        ]
        assert share[0] > 0.0  # each record's own
        assert 0.0 < share[1] < 0.1 * share[2]

    def test_the_error_that_is_told_is_that_between_seeds(self):
        records, scan, noise = scene(WIDE, 4)
        tables = [budget(brs.fit(records, scan, noise=noise, seed=seed, sampler="direct", campaign="off"),
                         yaw_sd_deg=5.0) for seed in range(1, 9)]  # fmt: skip
        share = np.stack([column(table).to_numpy() for table in tables])
        told = np.sqrt(np.mean([column(table, "share_mcse").to_numpy() ** 2 for table in tables], axis=0))
        scatter = share.std(axis=0, ddof=1)
        ratio = scatter[told > 1e-6] / told[told > 1e-6]
        assert 0.6 < np.median(ratio) < 1.6  # eight seeds, and three degrees of freedom each
        assert told.max() < 0.02


class TestRecords:
    def test_the_mean_is_that_of_the_records(self):
        records, scan, noise = scene()
        records["flag"].values[2] = 1
        found = fit(records, scan, noise=noise)
        each, whole = budget(found, each=True, yaw_sd_deg=3.0), budget(found, yaw_sd_deg=3.0)
        assert each["record"].unique().tolist() == [0, 1, 3, 4, 5]
        assert whole.attrs["n_record"] == 5
        mean = each.groupby(["stress", "source"], sort=False)["variance"].mean()
        np.testing.assert_allclose(mean.to_numpy(), whole["variance"].to_numpy(), rtol=1e-10)
        alone = budget(found, records=3, yaw_sd_deg=3.0)
        np.testing.assert_allclose(alone["variance"], each[each["record"] == 3]["variance"], rtol=1e-9)

    def test_the_interval_is_that_of_the_fit(self):
        records, scan, noise = scene()
        found = fit(records, scan, noise=noise, target_ess=4000, derived=["ti"], prob=0.8)
        last = budget(found).query("source == 'combined'").set_index("stress")
        mean = found.summary().groupby("stress", sort=False)[["mean", "low", "high", "decided"]].mean()
        assert last.index.tolist() == mean.index.tolist()
        assert set(last["prob"]) == {0.8}
        width = mean["high"] - mean["low"]
        for name in ("mean", "low", "high"):  # ends of 4000 draws, six records
            np.testing.assert_allclose(last[name], mean[name], atol=0.03 * float(width.max()))
        np.testing.assert_allclose(last["decided"], mean["decided"], atol=0.05)
        np.testing.assert_allclose(last["expanded"], 0.5 * (last["high"] - last["low"]), rtol=1e-12)

    def test_relative_to_the_estimate_or_to_what_a_covariance_stands_between(self):
        records, scan, noise = scene()
        table = budget(fit(records, scan, noise=noise))
        last = table[table["source"] == "combined"].set_index("stress")
        assert last.loc["vv", "relative"] == pytest.approx(last.loc["vv", "u"] / last.loc["vv", "mean"])
        between = np.sqrt(last.loc["uu", "mean"] * last.loc["ww", "mean"])
        assert last.loc["uw", "relative"] == pytest.approx(last.loc["uw", "u"] / between)

    def test_in_a_folder_it_is_the_same(self, tmp_path):
        records, scan, noise = scene()
        options = {"noise": noise, "nuisances": Nuisances(yaw_sd_deg=3.0), "derived": ["ti"]}
        memory = budget(fit(records, scan, **options))
        folder = brs.open_fit(fit(records, scan, output=tmp_path / "out", **options).place)
        pd.testing.assert_frame_equal(budget(folder), memory, check_exact=True)
        of_records = budget_of_records(records, scan, seed=1, **options)
        np.testing.assert_allclose(of_records["variance"], memory["variance"], rtol=1e-9)

    def test_of_a_folder_whose_noise_was_made(self, tmp_path):
        series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=3, seed=1)
        records = brs.make_records(series, "2-beam")
        memory = budget(fit(records, "2-beam"))
        folder = budget(fit(records, "2-beam", output=tmp_path / "out"))
        np.testing.assert_allclose(folder["variance"], memory["variance"], rtol=1e-6)

    def test_many_beams_and_other_priors(self):
        records, scan, noise = scene("50-beam", 3)
        for prior in ("flat", "mann", "ratio"):
            share = column(budget(fit(records, scan, noise=noise, prior=prior), yaw_sd_deg=2.0))
            np.testing.assert_allclose(share.drop("combined").sum(), 1.0, rtol=1e-12)
            assert (share.loc["prior"] >= 0.0).all()

    def test_a_hard_record_gets_more_draws_and_others_keep_theirs(self):
        records, scan, noise = scene(n_record=3)
        records["flag"].values[1, 1:] = 1  # one beam, and much that is uncertain
        uncertain = {"yaw_sd_deg": 12.0, "tilt_sd_deg": 6.0, "vertical_gradient_sd": 1.2, "inflation_dof": 3.0}
        found = fit(records, scan, noise=noise)
        each = budget(found, each=True, n_draw=1024, **uncertain)
        assert each.attrs["least_effective"] > 100.0  # 3 of 1024 without
        assert each[each["record"] == 1]["share_mcse"].max() < 0.2
        easy = budget(fit(records.isel(record=[0, 2]), scan, noise=noise), each=True, n_draw=1024, **uncertain)
        others = each[each["record"] != 1]
        np.testing.assert_allclose(others["variance"], easy["variance"], rtol=1e-9)

    def test_what_cannot_be_told_is_refused(self):
        records, scan, noise = scene("6-beam", 2)
        found = fit(records, scan, noise=noise)
        with pytest.raises(InputError, match=r"Unknown nuisance 'yaw_deg' of a budget"):
            budget(found, yaw_deg=2.0)
        with pytest.raises(InputError, match=r"Invalid n_draw 10"):
            budget(found, n_draw=10)
        with pytest.raises(
            InputError, match=r"Invalid probe_length_log_sd 0\.1: the beams of scan '6-beam' are points"
        ):
            budget(found, probe_length_log_sd=0.1)
        with pytest.raises(InputError, match=r"No record was fitted"):
            budget(found, records=[])


class TestShown:
    @pytest.fixture(scope="class")
    @classmethod
    def table(cls):
        records, scan, noise = scene("6-beam")
        return budget(fit(records, scan, noise=noise, derived=["ti"]), yaw_sd_deg=5.0, vertical_gradient_sd=0.5)

    def test_the_lines_hold_the_shares(self, table):
        lines = budget_lines(table)
        assert lines[0].split()[-7:] == [*STRESSES, "ti"]
        share = column(table)
        for source, line in zip(share.index[:-1], lines[1:], strict=False):
            assert line.startswith(source)
            shown = [float(word) for word in line[30:].replace("%", "").replace("−", "-").split()]
            np.testing.assert_allclose(shown, 100.0 * share.loc[source], atol=0.5001)
        assert lines[-1].startswith("taken for known: scatter beyond theory, length scale")

    def test_the_picture_has_a_bar_for_each_share(self, table):
        figure = brs.plot.budget(table)
        assert isinstance(figure, Figure)
        (axis,) = figure.axes
        share = column(table).drop("combined")
        height = np.array([[bar.get_height() for bar in container] for container in axis.containers])
        np.testing.assert_allclose(height, 100.0 * share.to_numpy(), atol=1e-9)
        hatches = [container[0].get_hatch() for container in axis.containers]
        assert [bool(hatch) for hatch in hatches] == [name == "prior" for name in share.index]
        below = height < 0.0
        bottom = np.array([[bar.get_y() for bar in container] for container in axis.containers])
        assert (bottom[~below] >= 0.0).all()
        assert (bottom[below] <= 0.0).all()
        words = [label.get_text() for label in axis.get_xticklabels()]
        assert words[0].startswith("uu\nu = ")
        assert "mostly\nthe prior’s" in words[1]  # vv of one narrow cone

    def test_it_draws_on_what_is_given_and_refuses_other_tables(self, table):
        axis = Figure().subplots()
        assert brs.plot.budget(table, ax=axis) is axis
        with pytest.raises(InputError, match=r"give that of bayes_rs\.budget"):
            brs.plot.budget(pd.DataFrame({"stress": []}))
        with pytest.raises(InputError, match=r"it has a budget for each of several records"):
            brs.plot.budget(pd.concat([table, table]))

    def test_the_command_writes_table_and_picture(self, tmp_path, monkeypatch, capsys):
        records, scan, noise = scene("6-beam", 3)
        records.to_netcdf(tmp_path / "records.nc", engine="h5netcdf")
        noise.save(tmp_path / "noise.nc")
        monkeypatch.chdir(tmp_path)
        words = "sensitivity records.nc --scan 6-beam --noise noise.nc --sampler direct --yaw-sd 5 --budget b.csv"
        monkeypatch.setattr(sys, "argv", ["bayes-rs", *words.split(), "--budget", "b.png"])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        assert not caught.value.code
        out = capsys.readouterr().out
        options = {"noise": noise, "nuisances": Nuisances(yaw_sd_deg=5.0), "sampler": "direct", "derived": ["ti"]}
        expected = budget_of_records(records, scan, seed=1, **options)
        written = pd.read_csv("b.csv")
        np.testing.assert_allclose(written["variance"], expected["variance"], rtol=1e-12)
        for line in budget_lines(expected):
            assert line in out
        assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")
