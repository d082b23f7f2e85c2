"""What the prior supplied is told from what the data said in every picture, and every picture is fit to be shown."""

import io
from itertools import combinations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from test_plots import TRUTH, fitted

import bayes_rs as brs
from bayes_rs import STRESSES, InputError
from bayes_rs.fits.shape_points import shape_points
from bayes_rs.geometry.scan_file import load_scan
from bayes_rs.intervals import interval_of
from bayes_rs.pictures import COLOURS, PRIOR_COLOUR, TRUTH_COLOUR, Picture
from bayes_rs.plot.density import LEVELS, outlines, smooth, smooth_pair
from bayes_rs.plot.style import prior_band
from bayes_rs.posteriors.decided import PRIORS
from bayes_rs.posteriors.prior_at_size import prior_interval_at_size
from bayes_rs.report.figures import shape_data
from bayes_rs.report.report_data import report_data

HATCH = "////"


@pytest.fixture(scope="module")
def found():
    return fitted(4, broken=[2])


def with_decided(found, values, monkeypatch):
    """Let the fit say that the data decided these shares, shape (n_record, 6)."""
    own = type(found).of_stresses
    monkeypatch.setattr(
        type(found),
        "of_stresses",
        lambda self, *names, **more: {
            name: np.array(values, dtype=float) if name == "decided" else part
            for name, part in own(self, *names, **more).items()
        },
    )
    summary = type(found).summary

    def told(self, **options):
        table = summary(self, **{**options, "columns": None}).copy()
        for row in table.index[table["stress"].isin(STRESSES)]:
            record, name = int(table["record"][row]), table["stress"][row]
            table.loc[row, "decided"] = values[record][STRESSES.index(name)]
        return table[list(options["columns"])] if options.get("columns") else table

    monkeypatch.setattr(type(found), "summary", told)


def hatched_of(axis):
    return [band for band in axis.collections if band.get_hatch() == HATCH]


def legend_words(figure):
    return " ".join(text.get_text() for legend in figure.legends for text in legend.get_texts()).replace("\n", " ")


class TestStresses:
    def test_each_record_and_stress_by_its_own_share(self, found, monkeypatch):
        """uu is decided in all records, vv in none, ww in the second alone: there the hatching ends half-way to it."""
        shares = np.full((4, 6), 0.9)
        shares[:, 1] = 0.1
        shares[:, 2] = (0.1, 0.9, np.nan, 0.9)
        with_decided(found, shares, monkeypatch)
        figure = brs.plot.stresses(found)
        uu, vv, ww = figure.axes[:3]
        assert (len(hatched_of(uu)), len(hatched_of(vv)), len(hatched_of(ww))) == (0, 1, 1)
        places = np.concatenate([path.vertices[:, 0] for path in hatched_of(ww)[0].get_paths()])
        start = mpl.dates.date2num(found.time)
        assert (places.min(), places.max()) == pytest.approx((start[0], 0.5 * (start[0] + start[1])))
        assert PRIORS in legend_words(figure)
        assert "mostly the prior’s in 1 of 3" in ww.get_title(loc="right")
        assert uu.get_title(loc="right") == "the data decided 90 % (median)"

    def test_nothing_is_hatched_where_the_data_decided_all(self, found, monkeypatch):
        with_decided(found, np.full((4, 6), 0.9), monkeypatch)
        figure = brs.plot.stresses(found)
        assert not any(hatched_of(axis) for axis in figure.axes)
        assert PRIORS not in legend_words(figure)


class TestCorner:
    @pytest.mark.parametrize("share", [0.49, 0.51])
    def test_a_stress_turns_with_its_share(self, found, monkeypatch, share):
        shares = np.full((4, 6), 0.9)
        shares[1, 4] = share
        with_decided(found, shares, monkeypatch)
        figure = brs.plot.corner(found, 1)
        places = [(row, column) for row in range(6) for column in range(row + 1)]
        for place, axis in zip(places, figure.axes, strict=True):
            hatched = any(HATCH in (getattr(band, "hatches", None) or [band.get_hatch()]) for band in axis.collections)
            assert hatched == (4 in place and share < 0.5), place
        assert ("the data decided less than half" in legend_words(figure)) == (share < 0.5)


class TestLumley:
    def test_the_point_is_the_tables_and_the_reports(self, found):
        table = found.summary(derived=("lumley_xi", "lumley_eta")).set_index(["record", "stress"])
        for record in (0, 1, 3):
            expected = [table["median"][record, name] for name in ("lumley_xi", "lumley_eta")]
            axis = brs.plot.lumley(found, record).axes[0]
            (drawn,) = [bars.lines[0].get_xydata() for bars in axis.containers]
            np.testing.assert_allclose(drawn, [expected], rtol=1e-12)
            np.testing.assert_allclose(shape_points(found).middle[record], expected, rtol=1e-12)
        data = shape_data(report_data(found))
        whole = np.concatenate([bars.lines[0].get_xydata() for bars in brs.plot.lumley(found).axes[0].containers])
        shown = np.stack([data["xi"], data["eta"]], axis=-1)
        np.testing.assert_allclose(sorted(shown.tolist()), sorted(whole.tolist()), rtol=1e-3)  # the page's digits

    @pytest.mark.parametrize("share", [0.49, 0.51])
    def test_a_shape_without_its_variances_is_the_priors(self, found, monkeypatch, share):
        shares = np.full((4, 6), 0.9)
        shares[:, 2] = share
        with_decided(found, shares, monkeypatch)
        axis = brs.plot.lumley(found, 1).axes[0]
        (bars,) = axis.containers
        assert (bars.lines[0].get_color() == PRIOR_COLOUR) == (share < 0.5)
        words = " ".join(text.get_text() for text in axis.get_legend().get_texts())
        assert ("mostly the prior" in words) == (share < 0.5)
        assert "equal-tailed" in words


class TestPriorAtSize:
    def test_it_is_that_of_shape_times_size(self):
        rng = np.random.default_rng(1)
        prior = brs.priors.WeakPrior().draw(4000, 1)
        for mean, sd in ((2.0, 0.5), (0.3, 0.2)):
            log_sd = np.sqrt(np.log1p((sd / mean) ** 2))
            size = mean * np.exp(log_sd * rng.standard_normal(200_000) - 0.5 * log_sd**2)
            shape = prior / prior[:, :3].sum(axis=1, keepdims=True)
            expected = interval_of((np.resize(shape, (200_000, 6)) * size[:, None]).T, 0.9)
            low, high = prior_interval_at_size(prior, np.array([mean]), np.array([sd]), 0.9)
            width = expected[1] - expected[0]
            # both have Monte-Carlo errors: of 4000 pairs of shape and size, about 2 % of the width at each end
            np.testing.assert_allclose(low[0], expected[0], atol=0.06 * width.max())
            np.testing.assert_allclose(high[0] - low[0], width, rtol=0.08)

    def test_records_that_were_not_fitted_have_none(self, found):
        band = prior_band(found, 0.9)
        assert band.shape == (2, 4, 6)
        assert np.isnan(band).all(axis=(0, 2)).tolist() == [False, False, True, False]


class TestDensity:
    def test_contours_hold_what_they_say(self):
        """Of a normal distribution they are circles with the exact probability, within the error of 4000 draws."""
        rng = np.random.default_rng(4)
        draws = rng.standard_normal((2, 4000))
        x, y, density, value = smooth_pair(*draws, positive=(False, False), levels=LEVELS)
        fresh = rng.standard_normal((2, 100_000))
        cell = [
            np.clip(np.searchsorted(grid, part), 0, len(grid) - 1) for grid, part in zip((x, y), fresh, strict=True)
        ]
        for level, one in zip(LEVELS, value, strict=True):
            assert np.mean(density[cell[1], cell[0]] >= one) == pytest.approx(level, abs=0.03)

    def test_a_variance_is_never_below_zero(self):
        draws = np.abs(np.random.default_rng(5).standard_normal(3000))
        x, density = smooth(draws, positive=True)
        assert x.min() > 0.0
        assert np.trapezoid(density, x) == pytest.approx(1.0, abs=0.02)  # the grid's ends
        assert density[0] == pytest.approx(2.0 * 0.3989, rel=0.15)  # no dip at the border

    def test_long_tails_make_no_islands(self):
        from scipy import ndimage  # noqa: PLC0415

        rng = np.random.default_rng(6)
        first = np.exp(1.2 * rng.standard_normal(800))
        second = first * rng.standard_normal(800)
        _, _, density, value = smooth_pair(first, second, positive=(True, False), levels=LEVELS)
        assert [ndimage.label(density >= one)[1] for one in value] == [1, 1]

    @pytest.mark.parametrize("n_grid", [48, 144])
    def test_outlines_are_closed_even_at_zero_and_hold_what_they_say_on_a_coarse_grid(self, n_grid):
        rng = np.random.default_rng(7)
        first, second = np.abs(rng.standard_normal(4000)), rng.standard_normal(4000)
        for level, lines in zip(LEVELS, outlines(first, second, positive=(True, False), n_grid=n_grid), strict=True):
            assert len(lines) == 1
            assert np.array_equal(lines[0][0], lines[0][-1])
            inside = mpl.path.Path(lines[0]).contains_points(np.column_stack([first, second]))
            assert inside.mean() == pytest.approx(level, abs=0.03)
            assert abs(lines[0][:, 0].min()) < 0.1  # half a cell from the border

    def test_a_number_that_does_not_vary_is_drawn(self):
        assert all(np.isfinite(one).all() for one in smooth_pair(np.ones(99), np.arange(99.0), positive=(False, False)))


def pictures(found):
    table = brs.compare(["6-beam", "zx-tm"], n_records=4)
    lines = brs.compare("6-beam@opening_angle_deg=15/45", n_records=4)
    grid = brs.compare("6-beam@opening_angle_deg=15/45,focus_distance=50/100", n_records=4)
    return {
        "stresses": lambda **on: brs.plot.stresses(found, truth=TRUTH, **on),
        "corner": lambda **on: brs.plot.corner(found, 1, truth=TRUTH, **on),
        "scan": lambda **on: brs.plot.scan(load_scan("6-beam"), **on),
        "bars": lambda **on: brs.plot.comparison(table, **on),
        "lines": lambda **on: brs.plot.comparison(lines, **on),
        "grid": lambda **on: brs.plot.comparison(grid, **on),
    }


NAMES = ("stresses", "corner", "scan", "bars", "lines", "grid")


@pytest.fixture(scope="module")
def drawn(found):
    return pictures(found)


def text_boxes(figure):
    """Return the words and boxes, pixels, of all texts that are shown but for numbers on axes and beside beams."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    texts = figure.findobj(mpl.text.Text)
    shown = [text for text in texts if text.get_visible() and text.get_text().strip()]
    hidden = {id(text) for axis in figure.axes if not axis.get_visible() for text in axis.findobj(mpl.text.Text)}
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in shown if id(text) not in hidden]
    inside = [
        (words, box) for words, box in boxes if box.width > 0 and not words.replace("−", "").replace(".", "").isdigit()
    ]
    return [(words, box) for words, box in inside]


class TestShown:
    @pytest.mark.parametrize("name", [*NAMES, "lumley"])
    def test_no_text_lies_on_another_or_beyond_the_edge(self, found, drawn, name):
        figure = brs.plot.lumley(found, 1) if name == "lumley" else drawn[name]()
        boxes = text_boxes(figure)
        for (one, box), (other, there) in combinations(boxes, 2):
            common = mpl.transforms.Bbox.intersection(box, there)
            # two pixels: the boxes hold the room of letters that go below the line
            assert common is None or min(common.width, common.height) <= 2.0, (one, other)
        for words, box in boxes:
            edge = figure.bbox
            assert min(box.x0 - edge.x0, edge.x1 - box.x1, box.y0 - edge.y0, edge.y1 - box.y1) >= -1.0, words

    @pytest.mark.parametrize("name", NAMES)
    def test_every_axis_has_its_unit(self, drawn, name):
        for axis in drawn[name]().axes:
            for label in (axis.get_xlabel(), axis.get_ylabel()):
                assert not label or label[-1] in "])" or "(UTC)" in label or label.startswith("degrees"), label

    @pytest.mark.parametrize("name", NAMES)
    def test_they_draw_where_they_are_told_and_return_it(self, drawn, name):
        figure = Figure(figsize=(12.0, 6.0), layout="constrained")
        left, right = figure.subfigures(1, 2)
        assert drawn[name](figure=left) is left
        assert left.axes
        assert not right.axes
        with pytest.raises(InputError, match="Invalid figure 3: give a matplotlib Figure or SubFigure"):
            drawn[name](figure=3)

    def test_lumley_takes_axes(self, found):
        axis = Figure().subplots()
        assert brs.plot.lumley(found, ax=axis) is axis
        with pytest.raises(InputError, match="Invalid ax 3: give matplotlib Axes"):
            brs.plot.lumley(found, ax=3)

    def test_a_figure_shows_itself_and_is_none_of_pyplots(self, drawn):
        figure = drawn["scan"]()
        assert isinstance(figure, Picture)
        assert figure._repr_png_().startswith(b"\x89PNG")
        assert plt.get_fignums() == []
        from IPython.core.formatters import DisplayFormatter  # noqa: PLC0415 - slow to load

        shown, _ = DisplayFormatter().format(figure)  # what a notebook shows, with no magic and no pyplot
        assert sorted(shown) == ["image/png", "text/plain"]


def luminance(colour):
    """Return the relative luminance of a colour (WCAG 2)."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return linear, float(linear @ [0.2126, 0.7152, 0.0722])


def as_deuteranope(colour):
    """Return a colour as people without green cones see it, linear RGB; Viénot, Brettel and Mollon (1999)."""
    linear, _ = luminance(colour)
    matrix = np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]])
    return np.clip(matrix @ linear, 0.0, 1.0)


def test_colours_stay_apart_without_green_cones():
    """The least distance in linear RGB; two greens and reds that are one to them differ by less than 0.05."""
    seen = {colour: as_deuteranope(colour) for colour in (*COLOURS, TRUTH_COLOUR)}
    for one, other in combinations(seen, 2):
        assert np.linalg.norm(seen[one] - seen[other]) > 0.08, (one, other)


def test_the_table_names_its_interval(found):
    assert set(found.summary()["interval"]) == {"equal-tailed"}
    narrow = found.summary(interval="highest-density")
    assert set(narrow["interval"]) == {"highest-density"}
    wide = found.summary()
    known = wide["mean"].notna()
    assert ((narrow["high"] - narrow["low"])[known] <= 1.02 * (wide["high"] - wide["low"])[known]).all()
    pd.testing.assert_series_equal(narrow["median"], wide["median"])
    with pytest.raises(InputError, match="interval 'hdi'"):
        found.summary(interval="hdi")
    sink = io.StringIO()
    narrow.to_csv(sink)
    assert "highest-density" in sink.getvalue()
