"""The comparison of scans: laws, the two speeds against each other, grids, the folder and the picture."""

import io
import json
import sys
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from bayes_rs import InputError, compare, load_scan, load_turbulence, save_scan
from bayes_rs.cli import main
from bayes_rs.design.compare_job import comparison_words, run_compare
from bayes_rs.design.compare_options import CompareOptions
from bayes_rs.design.comparing import COLUMNS, enough_beams
from bayes_rs.design.comparison_plot import comparison
from bayes_rs.design.scan_grid import DESIGN
from bayes_rs.design.trial_records import drawn_records, explained_errors
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.intervals import INTERVALS
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.options import options_of
from bayes_rs.pictures import POSTERIOR_COLOUR
from bayes_rs.posteriors.decided import PRIORS

FLOW = load_turbulence("fu-2022")
CROSS_WIND = ("vv", "ww", "vw")
SMALL = {"n_records": 8, "estimators": ()}


@pytest.fixture(scope="module")
def table():
    return compare(["4-beam", "6-beam", "6-beam@opening_angle_deg=45"], method="both", n_records=64)


def of(table, scan, stress, column, data="fast", estimator="posterior"):
    return float(table.set_index(["scan", "stress", "data", "estimator"])[column].loc[(scan, stress, data, estimator)])


class TestTable:
    def test_columns_and_rows(self, table):
        assert list(table.columns) == list(COLUMNS)
        posterior = table[table["estimator"] == "posterior"]
        assert len(posterior) == 3 * 2 * 6
        assert posterior.drop(columns=["full_over_fast"]).notna().all(axis=None)
        assert set(posterior["rank"]) == {4, 6}

    def test_a_larger_opening_angle_knows_the_cross_wind_stresses_better(self, table):
        for stress in ("vv", "ww", "uv", "uw", "vw"):
            wide, narrow = (of(table, name, stress, "width_90") for name in ("6-beam", "6-beam@opening_angle_deg=45"))
            assert narrow < 0.8 * wide

    def test_fast_and_full_agree(self, table):
        """Widths vary by 25 % from record to record: means of 64 have 3 %; their ratio 4.4 %, and three times that."""
        ratio = table[(table["estimator"] == "posterior") & (table["data"] == "full")]["full_over_fast"]
        assert (np.abs(ratio - 1.0) < 0.13).all()

    def test_least_squares_on_the_same_records_is_not_better_than_the_posterior_at_fifteen_degrees(self, table):
        for data in ("fast", "full"):
            classic = of(table, "6-beam", "vv", "rmse", data, "lsq")
            assert classic > 3.0 * of(table, "6-beam", "vv", "rmse", data)

    def test_least_squares_gives_nothing_that_four_beams_do_not_see(self, table):
        rows = table.query("scan == '4-beam' and estimator == 'lsq'")
        assert "vv" not in set(rows["stress"])

    def test_truth_is_the_record_s_tensor_or_the_ensemble_s(self, table):
        other = compare(["4-beam"], target="ensemble", n_records=4, estimators=())
        np.testing.assert_allclose(other["truth"], FLOW.stresses(), rtol=1e-12)
        assert of(table, "4-beam", "uu", "truth") < FLOW.stresses()[0]

    def test_more_noise_is_wider(self):
        quick, slow = (compare(["6-beam"], duration=T, n_records=32, estimators=()) for T in (3600.0, 600.0))
        assert quick["width_90"].iloc[0] < 0.7 * slow["width_90"].iloc[0]

    def test_same_seed_same_table(self):
        one, two = (compare(["4-beam"], n_records=8, seed=3).drop(columns="seconds") for _ in range(2))
        pd.testing.assert_frame_equal(one, two)

    def test_several_flows_and_priors(self):
        flows = [FLOW, load_turbulence("stable-onshore")]
        table = compare(["4-beam"], turbulence=flows, prior=["weak", "flat"], n_records=4, estimators=["lsp"])
        cases = table[table["estimator"] == "posterior"].groupby(["turbulence", "prior"]).size()
        assert len(cases) == 4
        assert (table[table["estimator"] == "lsp"]["stress"] == "uu").all()


@pytest.fixture(scope="module")
def grid():
    return compare("6-beam@centre=no/yes,opening_angle_deg=15/30/45,focus_distance=30/98", **SMALL)


@pytest.fixture(scope="module")
def beams():
    return compare("6-beam@n_beams=3/4/5/6/10/20,centre=no/yes", **SMALL)


@pytest.fixture(scope="module")
def durations():
    return compare("6-beam", duration=(300.0, 600.0, 1800.0), **SMALL)


def widths(table, column="width_ratio", **where):
    """Return a column of the rows at `where`, in the order of the table."""
    for name, value in where.items():
        table = table[table[name] == value]
    return table[column].to_numpy()


class TestGrid:
    """What opening angle, focus distance, number of beams, a centre beam and record length do."""

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
            assert widths(beams, "rank", n_beam=number, centre=False, stress="uu") == [5]
            assert widths(beams, "rank", n_beam=number, centre=True, stress="uu") == [6]

    def test_under_a_flat_prior_a_centre_beam_decides_uu_and_vv(self):
        table = compare("6-beam@centre=no/yes,opening_angle_deg=30", prior="flat", **SMALL)
        for stress in ("uu", "vv"):
            without, with_centre = widths(table, stress=stress)
            assert with_centre < 0.75 * without

    def test_more_than_enough_beams_buy_nothing(self, beams):
        """Ten and twenty beams differ by less than what `enough_beams` looks for: the explained errors are common."""
        for stress in STRESSES:
            for centre in (False, True):
                values = widths(beams, stress=stress, centre=centre)
                assert abs(values[-2] / values[-1] - 1.0) < 0.025  # 0.02 and the scatter of eight records

    def test_all_widths_are_of_intervals(self, grid):
        assert (grid["width_50"] < 0.6 * grid["width_90"]).all()
        assert (grid["width_90"] < grid["prior_width_90"]).all()

    def test_columns_say_what_a_scan_is(self, grid):
        assert len(grid) == 2 * 3 * 2 * 6
        first = grid.drop_duplicates("scan")
        for name, angle, far, centre, number in first[
            ["scan", "opening_angle_deg", "focus_distance", "centre", "n_beam"]
        ].itertuples(index=False):
            word = "yes" if centre else "no"
            assert name == f"6-beam@centre={word},opening_angle_deg={angle:g},focus_distance={far:g}"
            assert number == 6

    def test_the_axis_of_a_lidar_on_the_ground_is_up(self):
        row = compare("zx-300@focus_distance=100,probe=point,tilt_deg=2", **{**SMALL, "n_records": 2}).iloc[0]
        assert row[list(DESIGN)].tolist() == [50, False, 15.0, 100.0, 2.0, 0.0, 600.0]

    def test_a_cell_does_not_depend_on_those_beside_it(self, grid):
        name = "6-beam@centre=yes,opening_angle_deg=30,focus_distance=98"
        alone = compare(name, **SMALL)
        inside = grid[grid["scan"] == name].reset_index(drop=True)
        pd.testing.assert_frame_equal(alone.drop(columns="seconds"), inside.drop(columns="seconds"))


class TestDrawnRecords:
    @pytest.mark.parametrize("name", ["6-beam@n_beams=3,centre=no", "6-beam", "6-beam@n_beams=9"])
    def test_errors_that_some_stresses_explain(self, name):
        """Their covariance is S (Sᵀ Σ⁻¹ S)⁺ Sᵀ, which for beams as many as the rank is Σ."""
        scan = load_scan(name, opening_angle_deg=40.0)
        noise, truth = theory_noise(scan, FLOW, wind_speed=10.0), FLOW.stresses()
        root, turn = explained_errors(noise, truth)
        covariance = np.log1p(noise.covariance[0])
        slope = noise.gain[0] / (noise.gain[0] @ truth)[:, np.newaxis]
        explained = slope @ np.linalg.pinv(slope.T @ np.linalg.solve(covariance, slope), rcond=1e-10) @ slope.T
        # rounding, enlarged by the condition of the normal equations, and the floor under the eigenvalues of Σ
        np.testing.assert_allclose(root @ turn @ turn.T @ root, explained, atol=1e-9)
        np.testing.assert_allclose(root @ root, covariance, atol=1e-9)
        if scan.n_beam <= 6:
            np.testing.assert_allclose(explained, covariance, atol=1e-9)
        else:
            assert np.abs(explained - covariance).max() > 1e-4

    @pytest.mark.parametrize("name", ["staring", "6-beam", "51-beam"])
    def test_they_have_the_moments_of_the_noise(self, name):
        """Even numbers: 4096 of them have the moments of ten times as many random ones, five times their error."""
        scan = load_scan(name)
        noise, truth = theory_noise(scan, FLOW, wind_speed=10.0), FLOW.stresses()
        mean = noise.gain[0] @ truth
        log = np.log(drawn_records(scan, noise, mean, truth, 4096, 1)["variance"].values / mean)
        covariance = np.log1p(noise.covariance[0])
        error = 5.0 * covariance.max() * np.sqrt(2.0 / 40960)
        np.testing.assert_allclose(log.mean(axis=0), -0.5 * np.diag(covariance), atol=5.0 * np.sqrt(0.06 / 40960))
        np.testing.assert_allclose(np.atleast_2d(np.cov(log.T)), covariance, atol=error)


class TestEnough:
    def made(self, values):
        design = {"centre": True, "opening_angle_deg": 15.0, "focus_distance": 98.0, "tilt_deg": 0.0, "yaw_deg": 0.0}
        same = {**design, "duration": 600.0, "turbulence": "fu-2022", "prior": "weak", "data": "fast", "stress": "uu"}
        rows = [{"n_beam": n, "width_90": value, "estimator": "posterior", **same} for n, value in values]
        return pd.DataFrame(rows)

    def test_the_smallest_number_from_which_on_all_are_within(self):
        table = self.made([(3, 1.01), (4, 1.5), (5, 1.019), (6, 0.9), (50, 1.0)])
        assert enough_beams(table)[["enough", "most"]].to_numpy().tolist() == [[5, 50]]
        assert enough_beams(table, within=0.01)["enough"].tolist() == [6]
        assert enough_beams(table, within=0.6)["enough"].tolist() == [3]

    def test_it_is_the_last_where_nothing_is_enough(self):
        assert enough_beams(self.made([(3, 1.2), (4, 1.1), (5, 1.0)]))["enough"].tolist() == [5]

    def test_each_kind_of_scan_has_its_own(self, beams):
        found = enough_beams(beams)
        assert len(found) == 12
        assert set(found["most"]) == {20}
        assert found["enough"].max() <= 10

    def test_one_number_is_refused(self, grid):
        with pytest.raises(InputError, match="No scans of the table differ in their number of beams only"):
            enough_beams(grid)


class TestWords:
    def test_what_is_enough_and_what_a_centre_beam_buys(self, beams):
        rows = {line[:35].rstrip(): line[35:].split() for line in comparison_words(beams)}
        found = enough_beams(beams)
        for kind, words in ((True, "with"), (False, "without")):
            expected = [str(number) for number in found[found["centre"] == kind]["enough"]]
            assert next(cells for label, cells in rows.items() if label == f"enough beams, {words} a centre beam") == (
                expected
            )
        assert "a centre beam: width" in rows
        assert "  bias over uu with it" in rows

    def test_what_a_longer_record_buys(self, durations):
        short, _, long = widths(durations, stress="uu")
        line = next(line for line in comparison_words(durations) if line.startswith("300 to 1800 s"))
        assert line.split(":")[1].split()[1] == f"{100.0 * (long / short - 1.0):+.0f}"

    def test_where_a_grid_is_narrowest(self, grid):
        lines = comparison_words(grid)
        best = grid[grid["stress"] == "vv"].nsmallest(1, "width_ratio").iloc[0]
        angle, far = (next(line for line in lines if name in line).split() for name in ("opening angle", "focus dis"))
        assert (angle[3], far[3]) == (f"{best['opening_angle_deg']:g}", f"{best['focus_distance']:g}")


class TestScans:
    def test_changes_behind_a_name_are_in_the_label_and_in_the_scan(self):
        names = ["pulsed-4-beam", "pulsed-4-beam@probe=point"]
        table = compare(names, n_records=4, estimators=["lsp"]).query("estimator == 'lsp'").set_index("scan")
        assert table.index.tolist() == names
        assert table.loc[names[0], "bias"] < table.loc[names[1], "bias"]  # the estimators know of no probe

    def test_nothing_to_compare(self):
        with pytest.raises(InputError, match="There is no scan to compare"):
            compare([])

    def test_names_files_and_scans(self, tmp_path):
        scan, file = load_scan("4-beam"), save_scan(load_scan("4-beam"), tmp_path / "mine.toml")
        table = compare([scan, file, f"{file}@tilt_deg=0/1"], **{**SMALL, "n_records": 2})
        names = ["4-beam", str(file), f"{file}@tilt_deg=0", f"{file}@tilt_deg=1"]
        assert table["scan"].drop_duplicates().tolist() == names
        same = table[table["tilt_deg"] == 0.0].groupby("stress")["width_90"]
        assert (same.max() == same.min()).all()

    def test_turbulence_may_be_a_name_or_itself(self):
        one, two = (compare("staring", turbulence=flow, n_records=2) for flow in ("fu-2022", FLOW))
        pd.testing.assert_frame_equal(one.drop(columns="seconds"), two.drop(columns="seconds"))

    @pytest.mark.parametrize(
        ("scan", "message"),
        [
            ("6-beam@tilt_deg=1/1", "Invalid tilt_deg '1/1' of scan '6-beam': it names a value twice"),
            ("6-beam@tilt_deg=1/x", "Invalid tilt_deg 'x' of scan '6-beam': it must be a number"),
            (["6-beam", "6-beam"], "Scan '6-beam' is named twice"),
            ("6-beam@n_beams=0/3", "Invalid n_beams 0"),
        ],
    )
    def test_bad_scans(self, scan, message):
        with pytest.raises(InputError, match=message):
            compare(scan)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"method": "slow"}, "Unknown method of comparison 'slow'"),
            ({"target": "sonic"}, "Unknown target 'sonic'"),
            ({"estimators": ["magic"]}, "Unknown estimator 'magic'"),
            ({"duration": np.nan}, "Invalid duration nan s"),
            ({"duration": ()}, "give at least one, and each once"),
            ({"duration": (600.0, 600.0)}, "give at least one, and each once"),
            ({"duration": 1.0}, "sample"),
            ({"n_records": 1}, "n_records 1: it must be a whole number of at least 2"),
            ({"wind_speed": 0.0}, "wind_speed 0.0 m/s"),
            ({"seed": -1}, "seed -1"),
            ({"prior": "strong"}, "strong"),
            ({"turbulence": "none-such"}, "none-such"),
            ({"durations": 600.0}, "Unknown option 'durations' in the call of compare: did you mean 'duration'"),
        ],
    )
    def test_bad_options(self, options, message):
        with pytest.raises(InputError, match=message):
            compare("4-beam", **options)


class TestPicture:
    def test_a_bar_for_every_scan_and_case(self, table):
        figure = comparison(table, stresses=("uu", "vv"))
        assert len(figure.axes) == 2
        bars = figure.axes[0].patches
        widths = sorted(bar.get_width() for bar in bars)
        wanted = table[(table["estimator"] == "posterior") & (table["stress"] == "uu")]["width_ratio"]
        np.testing.assert_allclose(widths, sorted(wanted))

    def test_what_the_prior_decides_is_hatched(self, table):
        """A bar turns from hatched to solid with the share that the data decided, and the legend says what it is."""
        for share, hatch in ((0.49, "////"), (0.51, None)):
            figure = comparison(table.assign(decided=share))
            assert {bar.get_hatch() for axis in figure.axes for bar in axis.patches} == {hatch}
            words = [text.get_text() for text in figure.legends[0].get_texts()]
            assert (PRIORS in words) == (hatch is not None)
            assert figure.legends[0].get_title().get_text().endswith("equal-tailed")

    def test_the_priors_width_is_a_line(self, table):
        axis = comparison(table).axes[0]
        rows = table[(table["estimator"] == "posterior") & (table["stress"] == "uu")]
        expected = rows["prior_width_90_at_size"] / rows["truth"]
        drawn = [part.vertices[0, 0] for lines in axis.collections for part in lines.get_paths()]
        np.testing.assert_allclose(sorted(drawn), sorted(expected), rtol=1e-9)

    def test_contours_of_a_grid_where_two_things_vary(self, grid):
        figure = comparison(grid)
        assert [panel.get_title()[:2] for panel in figure.axes] == list(STRESSES)
        assert figure.axes[3].get_xlabel() == "opening angle [°]"
        assert figure.axes[3].get_ylabel() == "focus distance [m]"
        assert "6 beams, with a centre beam, records of 600 s" in figure.get_suptitle()
        figure.savefig(io.BytesIO(), format="png")

    def test_lines_where_one_thing_varies(self, beams, durations):
        figure = comparison(beams, stresses=["uu", "vw"])
        lines = [
            line
            for line in figure.axes[1].lines
            if line.get_color() == POSTERIOR_COLOUR and line.get_linestyle() != "None"
        ]
        assert [line.get_linestyle() for line in lines] == ["--", "-"]
        np.testing.assert_array_equal(lines[1].get_ydata(), widths(beams, stress="vw", centre=True))
        assert comparison(durations).axes[3].get_xlabel() == "record length [s]"

    def test_bars_where_it_is_no_grid(self, grid):
        """Three things, or two over which not all combinations are there, are no picture of two axes."""
        part = grid[~((grid["opening_angle_deg"] == 30.0) & (grid["focus_distance"] == 30.0))]
        both = pd.concat([grid, grid.assign(duration=1200.0)])
        for table in (part, both):
            assert len(comparison(table).axes) == 6

    def test_refusals(self, table):
        with pytest.raises(InputError, match="stress"):
            comparison(table, stresses=("xx",))
        for other in (pd.DataFrame({"a": [1]}), table.iloc[:0]):
            with pytest.raises(InputError, match="Not a table of scans"):
                comparison(other)


class TestLabels:
    def test_python_and_names_say_the_same(self):
        options = {"n_records": 4, "estimators": ()}
        one = compare(["6-beam", "4-beam"], label=["six", "four"], **options)
        other = compare(["six=6-beam", "four=4-beam"], **options)
        assert list(dict.fromkeys(one["scan"])) == ["six", "four"]
        pd.testing.assert_frame_equal(one.drop(columns="seconds"), other.drop(columns="seconds"))

    def test_labels_that_are_refused(self):
        with pytest.raises(InputError, match="there are 1 for 2 scans; give one for each"):
            compare(["6-beam", "4-beam"], label=["six"])
        with pytest.raises(InputError, match="Invalid label 'a@b'"):
            compare(["6-beam"], label="a@b")
        with pytest.raises(InputError, match="Scan 'a' is named twice"):
            compare(["a=6-beam", "a=4-beam"])


def test_the_narrowest_intervals_are_no_wider():
    tables = {kind: compare("6-beam", n_records=8, estimators=(), interval=kind) for kind in INTERVALS}
    for kind, table in tables.items():
        assert set(table["interval"]) == {kind}
    for name in ("width_90", "width_50", "prior_width_90"):
        assert (tables["highest-density"][name] < 1.01 * tables["equal-tailed"][name]).all(), name  # interpolation


def test_the_folder_holds_table_figure_and_json(tmp_path):
    table, words = run_compare(["4-beam", "staring"], tmp_path / "out", options={"n_records": 8})
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        "comparison.csv",
        "comparison.json",
        "comparison.png",
        "fingerprints.jsonl",
        "run.json",
    ]
    content = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert len(content["rows"]) == len(table)
    assert content["scene"]["scans"] == ["4-beam", "staring"]
    assert any("narrowest" in line for line in words)
    with pytest.raises(InputError, match="exists"):
        run_compare(["4-beam"], tmp_path / "out")


class TestCommand:
    OTHER: ClassVar = {
        "turbulence": ("stable-onshore", "fu-2022"),
        "prior": ("flat",),
        "wind_speed": 8.0,
        "duration": (300.0, 600.0),
        "target": "ensemble",
        "method": "both",
        "n_records": 3,
        "estimators": ("lsp",),
        "interval": "highest-density",
        "seed": 5,
    }
    """A value for every option that is not its default."""

    def test_every_option_arrives(self, monkeypatch, capsys, tmp_path):
        """The command's numbers are those of Python with the same options, and run.json holds them all."""
        assert list(self.OTHER) == [entry.name for entry in options_of(CompareOptions)]
        words = []
        for entry in options_of(CompareOptions):
            value = self.OTHER[entry.name]
            for one in value if isinstance(value, tuple) else (value,):
                words += [entry.flag, str(one)]
        monkeypatch.setattr(sys, "argv", ["bayes-rs", "compare", "staring", "4-beam", *words, "-o", f"{tmp_path}/out"])
        with pytest.raises(SystemExit) as done:
            main()
        assert not done.value.code, capsys.readouterr().err
        run = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
        for name, value in self.OTHER.items():
            assert np.array_equal(np.atleast_1d(run[name]), np.atleast_1d(value)), name
        table = pd.read_csv(tmp_path / "out" / "comparison.csv", keep_default_na=False)
        expected = compare(["staring", "4-beam"], **self.OTHER)
        assert len(table) == len(expected)
        np.testing.assert_allclose(table["rmse"].astype(float), expected["rmse"], rtol=1e-12)
        plain = compare(["staring", "4-beam"], n_records=3)
        assert set(expected["estimator"]) != set(plain["estimator"])

    def test_a_bad_option_is_one_line(self, monkeypatch, capsys, tmp_path):
        monkeypatch.setattr(sys, "argv", ["bayes-rs", "compare", "6-beam@angle=3/4", "-o", f"{tmp_path}/out"])
        with pytest.raises(SystemExit) as done:
            main()
        assert done.value.code == 2
        assert "Unknown change 'angle' of scan '6-beam'" in capsys.readouterr().err
