"""Figures: what is in them, which record they show, and that they can be saved."""

import matplotlib.dates as mdates
import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import STRESSES, InputError, fit, load_scan
from bayes_rs.intervals import INTERVALS, interval_of
from bayes_rs.pictures import POSTERIOR_COLOUR, PRIOR_COLOUR, TRUTH_COLOUR
from bayes_rs.plot import stresses_plot
from bayes_rs.plot.corner_plot import corner, corner_limits, default_limits, prior_at_size
from bayes_rs.plot.stresses_plot import stresses

TRUTH = np.array([1.0, 0.6, 0.4, 0.1, -0.2, 0.05])


def fitted(n_record, *, broken=(), timed=True, kept=None, turbines=None):
    scan = load_scan("6-beam")
    noise = plain_noise(scan)
    rng = np.random.default_rng(41)
    records = records_of(draw_variances(np.tile(TRUTH, (n_record, 1)), scan, noise, rng), scan)
    for record in broken:
        records["flag"][record] = 1
    if not timed:
        records = records.drop_vars("time")
    if kept is not None:
        records = records.isel(record=list(kept))
    if turbines is not None:
        records = records.assign(turbine=("record", list(turbines)))
    return fit(records, scan, noise=noise, seed=1, target_ess=200)


def drawn_between(axis, one, other):
    """Whether a line or a face of a panel is drawn at some place between two."""
    one, other = (float(axis.convert_xunits(place)) for place in (one, other))
    for line in axis.lines:
        x, y = line.get_xdata(orig=False), np.asarray(line.get_ydata(orig=False), dtype=float)
        reach = np.isfinite(y[1:]) & np.isfinite(y[:-1]) & (line.get_linestyle() != "None")
        if line.get_transform() == axis.transData and np.any(reach & (x[:-1] < other) & (x[1:] > one)):
            return True
    paths = [path.vertices[:, 0] for face in axis.collections for path in face.get_paths() if len(path.vertices) > 2]
    return any(x.min() < other and x.max() > one for x in paths)


@pytest.fixture(scope="module")
def result():
    return fitted(4, broken=[2])


@pytest.fixture(scope="module")
def pairs(result):
    return corner(result, 1, truth=TRUTH)


@pytest.fixture(scope="module")
def figure(result):
    return stresses(result)


def saved(figure, path):
    """Save, read back as an array (rows, columns, 3)."""
    figure.savefig(path, dpi=90)
    return matplotlib.image.imread(path)[..., :3]


def is_a_picture(image):
    """More than paper: a good many pixels of each of several colours."""
    pixels = (255.0 * image).astype(int).reshape(-1, 3)
    _, count = np.unique(pixels, axis=0, return_counts=True)
    return min(image.shape[:2]) > 400 and np.count_nonzero(count > 20) > 5


def is_of(line, colour):
    return to_hex(line.get_color()).upper() == colour


def panels_of(figure):
    """Return the panels of a corner plot, by row and column."""
    return dict(zip([(row, column) for row in range(6) for column in range(row + 1)], figure.axes, strict=True))


def has_colour(image, colour):
    wanted = np.array(matplotlib.colors.to_rgb(colour))
    return np.count_nonzero(np.abs(image - wanted).max(axis=-1) < 0.04) > 20


class TestFindingRecords:
    def test_by_number_and_by_its_text(self, result):
        assert [result.find_record(record) for record in (0, 3, "1", np.int64(3))] == [0, 3, 1, 3]

    def test_by_time(self, result):
        assert result.find_record("2020-01-01T00:10") == 1
        assert result.find_record("2020-01-01T00:30:00") == 3
        assert result.find_record("2020-01-01") == 0

    @pytest.mark.parametrize("record", [4, "4", -1, "-1"])
    def test_a_number_that_is_not_there(self, result, record):
        with pytest.raises(InputError, match=rf"No record {record}: there are 4, numbered from 0\."):
            result.find_record(record)

    def test_a_time_at_which_none_starts(self, result):
        message = (
            r"No record starts at 2020-01-01T00:05: the records start from 2020-01-01T00:00:.* to 2020-01-01T00:3.*"
        )
        message += r"; the last before it at 2020-01-01T00:00:00\."
        with pytest.raises(InputError, match=message):
            result.find_record("2020-01-01T00:05")

    @pytest.mark.parametrize("record", ["noon", "1.5", "2020-13-01"])
    def test_what_is_neither_number_nor_time(self, result, record):
        with pytest.raises(InputError, match=rf"Invalid record '{record}': give a number or a time such as 2020"):
            result.find_record(record)

    def test_a_record_that_was_not_fitted(self, result):
        for record in (2, "2020-01-01T00:20"):
            with pytest.raises(InputError, match=r"Record 2 was not fitted \(no_usable_beam\): choose another one"):
                corner(result, record)

    def test_a_time_in_utc_by_its_letter(self, result):
        assert result.find_record("2020-01-01T00:10Z") == 1


class TestWhatIsNoFit:
    """Records, or the name of a folder, in place of a fit: one line, wherever a fit is taken."""

    @pytest.mark.parametrize(
        "draw",
        [
            brs.plot.corner,
            brs.plot.stresses,
            brs.plot.lumley,
            brs.plot.campaign,
            brs.plot.profile,
            brs.budget,
            lambda fit: prior_at_size(fit, 0),
            lambda fit: corner_limits([fit], [0]),
            lambda fit: brs.export_boxes(fit, 0, "none", seed=1),
        ],
    )
    @pytest.mark.parametrize("given", ["records", "none"])
    def test_it_is_refused(self, draw, given, result):
        with pytest.raises(InputError, match=r"Invalid fit, (Dataset of xarray|'none'): give what"):
            draw(result.records if given == "records" else given)

    def test_a_folder_that_is_no_name_and_a_table_that_is_none(self, result):
        with pytest.raises(InputError, match="Invalid folder of a fit <Fit"):
            brs.open_fit(result)
        with pytest.raises(InputError, match="Invalid fit, Dataset of xarray"):
            brs.write_report(result.records)
        with pytest.raises(InputError, match="Not a table of scans"):
            brs.plot.comparison(result)


class TestCorner:
    def test_panels_are_named_in_the_order_of_the_stresses(self, pairs):
        axes = panels_of(pairs)
        assert [axes[5, column].get_xlabel() for column in range(6)] == [f"{name} [m² s⁻²]" for name in STRESSES]
        assert [axes[row, 0].get_ylabel() for row in range(1, 6)] == [f"{name} [m² s⁻²]" for name in STRESSES[1:]]

    @pytest.mark.parametrize("kind", INTERVALS)
    def test_titles_give_median_and_interval_and_the_legend_its_name(self, result, kind):
        draws = result["posterior/stress"].sel(record=1)
        figure = corner(result, 1, interval=kind, prob=0.8)
        for index, name in enumerate(STRESSES):
            values = draws.sel(component=name).values.ravel()
            low, high = interval_of(values, 0.8, kind)
            words = panels_of(figure)[index, index].texts[0].get_text()
            said = f"{name} = {np.median(values):z.2f}\n{low:z.2f} to {high:z.2f}\n"
            assert words.startswith(said.replace("-", "\N{MINUS SIGN}"))
        assert any(f"80 % interval, {kind}" in text.get_text() for text in figure.legends[0].get_texts())

    def test_some_stresses_alone(self, result):
        figure = corner(result, 1, stresses=["uu", "uw"])
        assert [axis.get_xlabel()[:2] for axis in figure.axes] == ["", "uu", "uw"]
        for wrong in (["uu"], ["uu", "uu"]):
            with pytest.raises(InputError, match="give at least two, and each once"):
                corner(result, 1, stresses=wrong)

    def test_truth_is_marked_in_every_panel_and_in_the_legend(self, result, pairs):
        axes = panels_of(pairs)
        for index in range(6):
            marks = [line for line in axes[index, index].lines if is_of(line, TRUTH_COLOUR)]
            assert [set(line.get_xdata()) for line in marks] == [{TRUTH[index]}]
        points = [line.get_xydata()[0] for line in axes[4, 0].lines if line.get_marker() == "s"]
        np.testing.assert_array_equal(points, [[TRUTH[0], TRUTH[4]]])
        words = [text.get_text() for text in pairs.legends[0].get_texts()]
        assert "truth" in words
        without = corner(result, 1)
        assert "truth" not in [text.get_text() for text in without.legends[0].get_texts()]
        assert not any(is_of(line, TRUTH_COLOUR) for axis in without.axes for line in axis.lines)

    def test_limits_are_obeyed(self, result):
        limits = np.stack([[0.0, 0.1, 0.0, -1.0, -1.5, -0.5], [3.0, 2.0, 1.5, 1.0, 0.5, 0.7]], axis=1)
        for (row, column), axis in panels_of(corner(result, 0, limits=limits)).items():
            assert axis.get_xlim() == pytest.approx(tuple(limits[column]))
            if column < row:
                assert axis.get_ylim() == pytest.approx(tuple(limits[row]))

    def test_title_says_scan_record_start_and_prior(self, result, pairs):
        assert pairs.get_suptitle() == "6-beam, record 1, 2020-01-01T00:10 UTC, prior weak"
        assert corner(result, 0, title="mine").get_suptitle() == "mine"

    def test_it_can_be_drawn_into_a_part_of_a_figure(self, result):
        figure = Figure(figsize=(8.0, 4.0))
        left, right = figure.subfigures(1, 2)
        assert corner(result, 0, figure=left) is left
        assert (len(left.axes), len(right.axes)) == (21, 0)

    def test_saved_it_is_a_picture_of_posterior_prior_and_truth(self, pairs, tmp_path):
        image = saved(pairs, tmp_path / "corner.png")
        assert is_a_picture(image)
        for colour in (POSTERIOR_COLOUR, PRIOR_COLOUR, TRUTH_COLOUR):
            assert has_colour(image, colour), colour

    def test_bad_arrays_are_refused(self, result):
        with pytest.raises(InputError, match=r"Invalid truth of shape \(3,\): the shape must be \(6\)"):
            corner(result, 0, truth=[1.0, 0.5, 0.3])
        with pytest.raises(InputError, match=r"Invalid limits of shape \(6,\): the shape must be \(6, 2\)"):
            corner(result, 0, limits=np.ones(6))


class TestLimits:
    def test_they_hold_the_central_99_percent_and_zero_for_variances(self):
        sample = np.linspace(1.0, 2.0, 1001)[:, None] * np.array([1.0, 1.0, 1.0, 1.0, -1.0, 1.0])
        limits = default_limits([sample, sample + 1.0])
        np.testing.assert_allclose(limits[:, 1], [2.995, 2.995, 2.995, 2.995, -0.005, 2.995], atol=1e-12)
        np.testing.assert_allclose(limits[:, 0], [0.0, 0.0, 0.0, 1.005, -1.995, 1.005], atol=1e-12)

    def test_several_plots_get_limits_that_hold_each(self, result):
        both = corner_limits([result, result], [0, 3])
        for record in (0, 3):
            one = corner_limits([result], [record])
            assert np.all(both[:, 0] <= one[:, 0])
            assert np.all(both[:, 1] >= one[:, 1])

    def test_prior_is_drawn_at_the_size_of_the_posterior(self, result):
        """Its trace has the posterior's distribution, its shape the prior's."""
        drawn = prior_at_size(result, 3)
        trace = result["posterior/stress"].sel(record=3, component=["uu", "vv", "ww"]).sum("component").values.ravel()
        assert set(np.round(drawn[:, :3].sum(axis=1), 9)) <= set(np.round(trace, 9))
        prior = result["prior/stress"].values.reshape(-1, 6)
        shapes = [R / R[:, :3].sum(axis=1, keepdims=True) for R in (drawn, prior)]
        np.testing.assert_allclose(*shapes, rtol=1e-12)


class TestStresses:
    def test_each_stress_has_its_panel(self, figure):
        assert [axis.get_ylabel().split()[0] for axis in figure.axes] == list(STRESSES)

    def test_medians_are_those_of_the_draws_at_the_start_of_the_record(self, result, figure):
        for axis, name in zip(figure.axes, STRESSES, strict=True):
            marks = np.concatenate([line.get_xydata() for line in axis.lines if line.get_marker() == "o"])
            expected = result["posterior/stress"].sel(component=name).median(("chain", "draw")).values
            drawn = dict(zip(mdates.num2date(marks[:, 0]), marks[:, 1], strict=True))
            assert len(drawn) == 3
            np.testing.assert_allclose([drawn[key] for key in sorted(drawn)], expected[[0, 1, 3]], rtol=1e-12)

    @pytest.mark.parametrize("kind", INTERVALS)
    def test_bands_hold_what_they_say(self, result, kind):
        figure = stresses(result, prob=0.8, interval=kind)
        draws = (
            result["posterior/stress"].sel(component="uu", record=[0, 1]).transpose("record", "chain", "draw").values
        )
        heights = np.concatenate(
            [path.vertices[:, 1] for band in figure.axes[0].collections for path in band.get_paths()]
        )
        for prob in (0.5, 0.8):
            for value in np.ravel(interval_of(draws.reshape(2, -1), prob, kind)):
                assert np.min(np.abs(heights - value)) < 1e-9
        words = [text.get_text() for text in figure.legends[0].get_texts()]
        assert {f"50 % interval, {kind}", f"80 % interval, {kind}"} <= set(words)

    def test_flagged_records_are_marked(self, result, figure):
        for axis in figure.axes:
            (marks,) = [line for line in axis.lines if line.get_marker() == "|"]
            np.testing.assert_array_equal(marks.get_xdata(), result["posterior"].coords["time"][[2]])
        assert "flagged record" in [text.get_text() for text in figure.legends[0].get_texts()]

    def test_nothing_is_marked_where_nothing_is_flagged(self):
        figure = stresses(fitted(2))
        assert not any(line.get_marker() == "|" for axis in figure.axes for line in axis.lines)
        assert "flagged record" not in [text.get_text() for text in figure.legends[0].get_texts()]

    def test_saved_it_is_a_picture_with_its_mark(self, figure, tmp_path):
        image = saved(figure, tmp_path / "stresses.png")
        assert is_a_picture(image)
        assert has_colour(image, POSTERIOR_COLOUR)

    def test_one_record_is_a_point_with_bars(self, tmp_path):
        figure = stresses(fitted(1))
        assert [len(axis.containers) for axis in figure.axes] == [1] * 6
        assert is_a_picture(saved(figure, tmp_path / "one.png"))

    def test_no_fitted_record_is_a_figure_too(self, tmp_path):
        figure = stresses(fitted(2, broken=[0, 1]))
        assert min(saved(figure, tmp_path / "none.png").shape[:2]) > 400

    def test_without_times_the_records_are_numbered(self, result):
        axis = stresses(fitted(4, broken=[2], timed=False)).axes[-1]
        assert axis.get_xlabel() == "record"
        marks = np.concatenate([line.get_xdata() for line in axis.lines if line.get_marker() == "o"])
        assert set(marks) == {0.0, 1.0, 3.0}
        assert isinstance(stresses(result).axes[-1].xaxis.get_major_formatter(), mdates.ConciseDateFormatter)

    @pytest.mark.parametrize("truth", [None, TRUTH])
    def test_nothing_is_drawn_across_a_time_without_records(self, truth):
        found = fitted(8, kept=[0, 1, 4, 5, 7])
        figure = stresses(found, truth=truth)
        for axis in figure.axes:
            of_time = dict(zip([0, 1, 4, 5, 7], found.time, strict=True))
            assert drawn_between(axis, of_time[0], of_time[1])
            assert drawn_between(axis, of_time[4], of_time[5])
            assert not drawn_between(axis, of_time[1], of_time[4])
            assert not drawn_between(axis, of_time[5], of_time[7])
            assert len(axis.containers) == 1  # the last record has no neighbour, and stands as a point with bars

    def test_records_that_all_stand_apart_are_points(self):
        figure = stresses(fitted(6, kept=[0, 5]))
        assert [len(axis.containers[0].lines[0].get_xdata()) for axis in figure.axes[:1]] == [2]

    def test_nothing_is_drawn_from_one_turbine_to_the_next(self):
        axis = stresses(fitted(4, turbines="AABB", timed=False)).axes[0]
        assert drawn_between(axis, 0, 1)
        assert not drawn_between(axis, 1, 2)
        assert drawn_between(axis, 2, 3)

    def test_of_many_records_a_gap_shorter_than_a_point_is_none(self, monkeypatch):
        monkeypatch.setattr(stresses_plot, "MOST_POINTS", 4)
        found = fitted(20, kept=[0, 1, 3, 4, 5, 6, 15, 16, 17])
        axis = stresses(found).axes[0]  # three to a point
        assert drawn_between(axis, found.time[0], found.time[3])
        assert not drawn_between(axis, found.time[3], found.time[6])

    def test_title_says_what_the_scan_sees(self, figure):
        assert figure.get_suptitle() == "6-beam: sees all six stresses; prior weak"

    def test_truth_is_marked_in_every_panel_and_in_the_legend(self, result, figure, tmp_path):
        each = TRUTH * np.array([1.0, 0.8, 1.1, 0.9])[:, None]
        for truth, expected in ((TRUTH, np.tile(TRUTH, (4, 1))), (each, each)):
            marked = stresses(result, truth=truth)
            for index, axis in enumerate(marked.axes):
                (line,) = [line for line in axis.lines if is_of(line, TRUTH_COLOUR)]
                np.testing.assert_array_equal(line.get_ydata(), expected[:, index])
                np.testing.assert_array_equal(line.get_xdata(), result["posterior"].coords["time"])
            assert "truth" in [text.get_text() for text in marked.legends[0].get_texts()]
        assert has_colour(saved(marked, tmp_path / "marked.png"), TRUTH_COLOUR)
        assert "truth" not in [text.get_text() for text in figure.legends[0].get_texts()]
        assert not any(is_of(line, TRUTH_COLOUR) for axis in figure.axes for line in axis.lines)

    def test_truth_of_one_record_is_a_point(self):
        lines = stresses(fitted(1), truth=TRUTH).axes[4].lines
        (line,) = [line for line in lines if is_of(line, TRUTH_COLOUR)]
        assert (line.get_marker(), line.get_ydata().tolist()) == ("s", [TRUTH[4]])

    @pytest.mark.parametrize(
        ("truth", "message"),
        [
            ([1.0, 0.5, 0.3], r"Invalid truth of shape \(3,\): the shape must be \(6\)"),
            ({"uu": 1.0}, r"Invalid truth \{'uu': 1\.0\}: it must be an array of numbers"),
            ([[1.0], [1.0, 0.5]], r"Invalid truth \[\[1\.0\], \[1\.0, 0\.5\]\]: it must be an array of numbers"),
            (np.ones((3, 6)), r"Invalid truth of shape \(3, 6\): the shape must be \(4, 6\)"),
            ([np.nan] * 6, r"Invalid truth: the entry at \(0,\) is nan"),
            (
                [1.0, 0.1, -0.3, 0.6, 0.0, 0.4],  # row by row
                r"Invalid truth: ww of record 0 is -0\.3, and .* in the order uu, vv, ww, uv, uw, vw\.",
            ),
        ],
    )
    def test_truth_that_is_refused(self, result, truth, message):
        with pytest.raises(InputError, match=message):
            stresses(result, truth=truth)

    def test_prob_that_is_no_probability(self, result):
        with pytest.raises(InputError, match=r"Invalid prob 90: it must be between 0 and 1"):
            stresses(result, prob=90)
