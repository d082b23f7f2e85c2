"""The trade-off: laws of the widths, the records against those of `compare`, refusals, the folder and the picture."""

import io
import json
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from bayes_rs import InputError, compare, enough_beams, load_scan, load_turbulence, plot_trade_off, trade_off
from bayes_rs.cli import commands
from bayes_rs.design.trade_job import run_trade_off
from bayes_rs.design.trading import COLUMNS, _explained_records, cone_scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.by_theory import theory_noise

FLOW = load_turbulence("fu-2022")
SMALL = {"n_records": 8}
CROSS_WIND = ("vv", "ww", "vw")


@pytest.fixture(scope="module")
def grid():
    return trade_off(opening_angle_deg=(15.0, 30.0, 45.0), focus_distance=(30.0, 98.0), centre=(False, True), **SMALL)


@pytest.fixture(scope="module")
def beams():
    return trade_off(
        n_beams=(3, 4, 5, 6, 10, 20), centre=(False, True), opening_angle_deg=15.0, focus_distance=98.0, **SMALL
    )


@pytest.fixture(scope="module")
def durations():
    return trade_off(opening_angle_deg=15.0, focus_distance=98.0, duration=(300.0, 600.0, 1800.0), **SMALL)


def widths(table, column="ratio_90", **where):
    """Return a column of the rows at `where`, in the order of the table."""
    for name, value in where.items():
        table = table[table[name] == value]
    return table[column].to_numpy()


class TestLaws:
    @pytest.mark.parametrize("stress", [*CROSS_WIND, "uv", "uw"])
    def test_a_wider_angle_knows_more_of_the_cross_wind_stresses(self, grid, stress):
        for far in (30.0, 98.0):
            values = widths(grid, stress=stress, focus_distance=far, centre=True)
            assert (np.diff(values) < 0.0).all()
            assert values[-1] < 0.85 * values[0]

    @pytest.mark.parametrize("stress", CROSS_WIND)
    def test_a_larger_focus_distance_knows_less_of_the_cross_wind_stresses(self, grid, stress):
        """The beams' errors are less alike farther apart, so that their differences say less."""
        for angle in (15.0, 30.0, 45.0):
            near, far = widths(grid, stress=stress, opening_angle_deg=angle, centre=True)
            assert far > 1.01 * near

    def test_a_larger_focus_distance_knows_more_of_uu(self, grid):
        """The beams see more different eddies."""
        for angle in (15.0, 30.0, 45.0):
            near, far = widths(grid, stress="uu", opening_angle_deg=angle, centre=True)
            assert far < 0.95 * near

    @pytest.mark.parametrize("stress", STRESSES)
    def test_a_longer_record_knows_more(self, durations, stress):
        assert (np.diff(widths(durations, stress=stress)) < 0.0).all()
        if stress not in CROSS_WIND:  # there the prior decides half of the probability at 15°
            assert (np.diff(widths(durations, "width_50", stress=stress)) < 0.0).all()

    def test_the_truth_of_a_longer_record_is_larger(self, durations):
        assert (np.diff(widths(durations, "truth", stress="uu")) > 0.0).all()

    def test_a_centre_beam_makes_uu_and_vv_plus_ww_separable(self, beams):
        """On a cone n_u² is the same for all beams: uu and vv + ww come in one sum. The centre beam sees uu alone."""
        for number in (6, 10, 20):
            assert widths(beams, "rank", n_beams=number, centre=False, stress="uu") == [5]
            assert widths(beams, "rank", n_beams=number, centre=True, stress="uu") == [6]

    def test_under_a_flat_prior_a_centre_beam_decides_uu_and_vv(self):
        table = trade_off(
            prior="flat",
            centre=(False, True),
            opening_angle_deg=30.0,
            focus_distance=98.0,
            stresses=("uu", "vv"),
            **SMALL,
        )
        for stress in ("uu", "vv"):
            without, with_centre = widths(table, stress=stress)
            assert with_centre < 0.75 * without

    def test_more_than_enough_beams_buy_nothing(self, beams):
        """Ten and twenty beams differ by less than half of what `enough_beams` looks for: the draws are common."""
        for stress in STRESSES:
            for centre in (False, True):
                values = widths(beams, stress=stress, centre=centre)
                assert abs(values[-2] / values[-1] - 1.0) < 0.01

    def test_all_widths_are_of_intervals(self, grid):
        assert (grid["width_50"] < 0.6 * grid["width_90"]).all()
        assert (grid["ratio_90"] < grid["prior_ratio_90"]).all()
        np.testing.assert_allclose(grid["ratio_90"] / grid["ratio_50"], grid["width_90"] / grid["width_50"], rtol=1e-12)


class TestTable:
    def test_columns_rows_and_order(self, grid):
        assert list(grid.columns) == list(COLUMNS)
        assert len(grid) == 2 * 3 * 2 * 6
        assert grid.notna().all(axis=None)
        assert "enough_beams" not in grid.attrs

    def test_the_cone_is_the_shipped_scan(self):
        scan = cone_scan(6, centre=True, opening_angle_deg=15.0, focus_distance=98.0)
        assert scan.key == load_scan("6-beam").key

    @pytest.mark.parametrize("scan", ["6-beam", "51-beam"])
    def test_records_are_those_of_compare(self, scan):
        """Means over 64 even records scatter by 1.2 % from seed to seed (of eight): four times √2 of that.

        For 51 beams this also shows that errors which no R explains do not count.
        """
        other = compare([scan], FLOW, n_records=64, estimators=[])
        number = load_scan(scan).n_beam
        table = trade_off(n_beams=number, opening_angle_deg=15.0, focus_distance=98.0, n_records=64)
        np.testing.assert_allclose(table["ratio_90"], other["width_ratio"], rtol=0.07)
        np.testing.assert_allclose(table["truth"], other["truth"], rtol=1e-12)
        np.testing.assert_allclose(table["rmse_ratio"], other["rmse"] / other["truth"].iloc[0], atol=0.03)

    @pytest.mark.parametrize("number", [3, 6, 9])
    def test_records_have_the_errors_that_some_stresses_explain(self, number):
        """Their covariance is S (Sᵀ Σ⁻¹ S)⁺ Sᵀ, which for beams as many as the rank is Σ; the mean is E[ln y]."""
        scan = cone_scan(number, centre=number > 3, opening_angle_deg=40.0, focus_distance=98.0)
        noise = theory_noise(scan, FLOW, wind_speed=10.0)
        truth, errors = FLOW.stresses(), np.sqrt(6.0) * np.vstack([np.eye(6), -np.eye(6)])
        log = np.log(_explained_records(scan, noise, truth, errors)["variance"].values)
        covariance = np.log1p(noise.covariance[0])
        slope = noise.gain[0] / (noise.gain[0] @ truth)[:, np.newaxis]
        explained = slope @ np.linalg.pinv(slope.T @ np.linalg.solve(covariance, slope), rcond=1e-10) @ slope.T
        np.testing.assert_allclose(
            log.mean(axis=0), np.log(noise.gain[0] @ truth) - 0.5 * np.diag(covariance), rtol=1e-12
        )
        # rounding, enlarged by the condition of the normal equations, and the floor under the eigenvalues of Σ
        np.testing.assert_allclose(np.cov(log.T, bias=True), explained, atol=1e-9)
        if number <= 6:
            np.testing.assert_allclose(explained, covariance, atol=1e-9)
        else:
            assert np.abs(explained - covariance).max() > 1e-4

    def test_same_seed_same_table(self):
        one, two, other = (
            trade_off(opening_angle_deg=15.0, focus_distance=98.0, seed=seed, **SMALL) for seed in (3, 3, 4)
        )
        pd.testing.assert_frame_equal(one, two)
        assert not np.allclose(one["width_90"], other["width_90"], rtol=1e-6)

    def test_a_cell_does_not_depend_on_those_beside_it(self, grid):
        alone = trade_off(opening_angle_deg=30.0, focus_distance=98.0, **SMALL)
        inside = grid[(grid["opening_angle_deg"] == 30.0) & (grid["focus_distance"] == 98.0) & grid["centre"]]
        pd.testing.assert_frame_equal(alone, inside.reset_index(drop=True))

    def test_stresses_are_chosen(self):
        table = trade_off(opening_angle_deg=15.0, focus_distance=98.0, stresses=["vv", "uw"], **SMALL)
        assert table["stress"].tolist() == ["vv", "uw"]


class TestEnough:
    def made(self, values):
        design = {"centre": True, "opening_angle_deg": 15.0, "focus_distance": 98.0, "duration": 600.0, "stress": "uu"}
        return pd.DataFrame([{"n_beams": n, "ratio_90": value, **design} for n, value in values])

    def test_the_smallest_number_from_which_on_all_are_within(self):
        table = self.made([(3, 1.01), (4, 1.5), (5, 1.019), (6, 0.9), (50, 1.0)])
        assert enough_beams(table)[["enough", "most"]].to_numpy().tolist() == [[5, 50]]
        assert enough_beams(table, within=0.01)["enough"].tolist() == [6]
        assert enough_beams(table, within=0.6)["enough"].tolist() == [3]

    def test_it_is_the_last_where_nothing_is_enough(self):
        assert enough_beams(self.made([(3, 1.2), (4, 1.1), (5, 1.0)]))["enough"].tolist() == [5]

    def test_the_attribute(self, beams):
        found = pd.DataFrame(beams.attrs["enough_beams"])
        pd.testing.assert_frame_equal(found, enough_beams(beams))
        assert len(found) == 12
        assert set(found["most"]) == {20}
        assert found["enough"].max() <= 10

    def test_one_number_is_refused(self, grid):
        with pytest.raises(InputError, match="one number of beams only: give trade_off several"):
            enough_beams(grid)


class TestRefusals:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"n_beams": 2}, "n_beams 2: it must be a whole number of at least 3"),
            ({"n_beams": 4.5}, "n_beams 4.5: it must be a whole number"),
            ({"n_beams": (5, 5)}, "n_beams: 5 follows 5; the values must increase"),
            ({"n_beams": ()}, "n_beams: there is no value"),
            ({"centre": (True, True)}, "centre .*: it must be True, False or both"),
            ({"centre": ()}, "centre .*: it must be True, False or both"),
            ({"opening_angle_deg": (30.0, 15.0)}, "opening_angle_deg: 15 follows 30"),
            ({"opening_angle_deg": 90.0}, "opening_angle_deg 90: it must be below 90 degrees"),
            ({"opening_angle_deg": 0.0}, "opening_angle_deg 0.0 degree: it must be a finite number above zero"),
            ({"focus_distance": -1.0}, "focus_distance -1.0 m: it must be a finite number above zero"),
            ({"duration": np.nan}, "duration: the entry at .* is nan"),
            ({"duration": 1.0}, "sample"),
            ({"stresses": ()}, "stresses .*: name at least one"),
            ({"stresses": ("uu", "uu")}, "stresses .*: name at least one, and each once"),
            ({"stresses": ("tt",)}, "Unknown stress 'tt'"),
            ({"n_records": 1}, "n_records 1: it must be a whole number of at least 2"),
            ({"scan_duration": 0.0}, "scan_duration 0.0 s"),
            ({"wind_speed": 0.0}, "wind_speed 0.0 m/s"),
            ({"seed": -1}, "seed -1"),
            ({"prior": "strong"}, "strong"),
            ({"turbulence": "none-such"}, "none-such"),
        ],
    )
    def test_bad_input(self, options, message):
        with pytest.raises(InputError, match=message):
            trade_off(**{"opening_angle_deg": 15.0, "focus_distance": 98.0, **options})


class TestPicture:
    def test_panels(self, grid, beams, durations):
        figure = plot_trade_off(grid, beams=beams, durations=durations)
        titles = [panel.get_title() for panel in figure.axes]
        assert len(titles) == 9
        assert [title[:2] for title in titles[:6]] == list(STRESSES)
        figure.savefig(io.BytesIO(), format="png")

    def test_contours_alone(self, grid):
        assert len(plot_trade_off(grid[~grid["centre"]]).axes) == 6

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda table: table.iloc[:0], "'grid' is none of a trade-off"),
            (lambda table: table.drop(columns="ratio_90"), "'grid' is none of a trade-off"),
            (lambda table: table[table["focus_distance"] == 98.0], "'grid' has one focus_distance only"),
            (lambda table: pd.concat([table, table.assign(duration=1.0)]), "'grid' has 2 values of duration"),
        ],
    )
    def test_a_table_that_it_cannot_show(self, grid, change, message):
        with pytest.raises(InputError, match=message):
            plot_trade_off(change(grid))


class TestJob:
    OPTIONS: ClassVar = {
        "--beams": (5,),
        "--angle": (15, 30),
        "--distance": (50, 98),
        "--number": (3, 5),
        "--records": (4,),
    }

    def test_the_folder_and_the_words(self, tmp_path):
        options = {**self.OPTIONS, "--record-length": (300, 600)}
        words = [word for name, values in options.items() for value in values for word in (name, str(value))]
        done = CliRunner().invoke(commands, ["trade-off", "-o", str(tmp_path / "out"), *words])
        assert done.exit_code == 0, done.output
        names = {path.name for path in (tmp_path / "out").iterdir()}
        assert names == {"grid.csv", "beams.csv", "durations.csv", "trade-off.png", "run.json"}
        grid = pd.read_csv(tmp_path / "out" / "grid.csv")
        assert list(grid.columns) == list(COLUMNS)
        assert set(grid["centre"]) == {True, False}
        run = json.loads((tmp_path / "out" / "run.json").read_text())
        assert run["numbers"] == [3, 5]
        assert len(run["enough_beams"]) == 12
        rows = {line[:9]: line for line in done.output.splitlines()}
        best = grid[grid["centre"] & (grid["stress"] == "vv")].nsmallest(1, "ratio_90").iloc[0]
        assert rows["narrowest"].split()[2] == f"{best['ratio_90']:.2f}"
        assert "enough beams, with a centre beam" in done.output
        assert "a centre beam, of 5: width" in done.output
        assert "300 to 600 s" in done.output

    def test_an_existing_folder_is_refused_before_any_work(self, tmp_path):
        (tmp_path / "out").mkdir()
        with pytest.raises(InputError, match="exists"):
            run_trade_off(tmp_path / "out", n_beams=-1)

    def test_one_value_is_refused(self, tmp_path):
        with pytest.raises(InputError, match=r"durations \[600.0\]: the figure needs at least two"):
            run_trade_off(tmp_path / "out", durations=[600.0])
        assert not (tmp_path / "out").exists()
