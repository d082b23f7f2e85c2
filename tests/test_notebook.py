"""What objects look like in a notebook and at a prompt: short, escaped, drawn without a plotting library."""

import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest
from scenes import TURBULENCE, plain_noise, records_of

import bayes_rs as brs
from bayes_rs.fits.fit_card import ranges_card
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.html_parts import bars, beams, card, heat_map, intervals, some

SCAN = brs.load_scan("6-beam")
EVIL = '<script>alert("1")</script>&'
MOST = 20_000  # characters: a notebook holds dozens of them


@pytest.fixture(scope="module")
def found():
    records = records_of(np.tile([[1.0, 0.6, 0.4, 0.0, -0.2, 0.0]], (3, 1)) @ design_matrix(SCAN).T, SCAN)
    records["flag"][1] = 1
    return brs.fit(records, SCAN, noise=plain_noise(SCAN), seed=1, target_ess=100)


@pytest.fixture(scope="module")
def shown(found):
    turbulence = replace(TURBULENCE, name=EVIL, source=EVIL)
    evil = replace(SCAN, name=EVIL, title=EVIL)
    return {
        "scan": evil,
        "many beams": brs.load_scan("spinnerlidar"),
        "upwards": brs.load_scan("windcube-v2"),
        "noise": replace(plain_noise(SCAN), scan_name=EVIL, turbulence=turbulence),
        "many correlations": plain_noise(brs.load_scan("51-beam")),
        "turbulence": turbulence,
        "prior": brs.priors.make_prior("weak"),
        "flat": brs.priors.make_prior("flat"),
        "gaussian": brs.priors.GaussianPrior([1.0, 0.6, 0.4, 0.0, -0.2, 0.0], 0.01 * np.eye(6)),
        "fit": replace(found, place=EVIL, run={**found.run, "prior_name": EVIL}),
    }


WHAT = (
    *("scan", "many beams", "upwards", "noise", "many correlations", "turbulence", "prior", "flat", "gaussian"),
    "fit",
)


class Checked(HTMLParser):
    """Knows elements, and whether each is closed where it should be."""

    def __init__(self):
        super().__init__()
        self.open, self.seen = [], set()

    def handle_starttag(self, tag, attrs):
        self.seen.add(tag)
        assert not any(name.startswith("on") for name, _ in attrs)
        self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


class TestHtml:
    @pytest.mark.parametrize("name", WHAT)
    def test_is_whole_short_and_has_a_picture(self, shown, name):
        html = shown[name]._repr_html_()
        parser = Checked()
        parser.feed(html)
        parser.close()
        assert parser.open == []
        assert {"svg", "table", "strong"} <= parser.seen
        assert "script" not in parser.seen
        assert len(html) < MOST
        ET.fromstring(html)  # noqa: S314 - our own: also XML, as SVG has to be

    @pytest.mark.parametrize("name", ["scan", "noise", "turbulence", "fit"])
    def test_hostile_names_stay_text(self, shown, name):
        html = shown[name]._repr_html_()
        assert "&lt;script&gt;" in html
        assert "<script" not in html

    @pytest.mark.parametrize("name", WHAT)
    def test_letters_have_the_colour_of_the_page(self, shown, name):
        """So that they are legible on a dark one, too: no black, no white, no background."""
        html = shown[name]._repr_html_()
        assert "currentColor" in html
        for fixed in ("#000", "#fff", "black", "white", "background:#"):
            assert fixed not in html

    @pytest.mark.parametrize("name", WHAT)
    def test_is_the_same_again(self, shown, name):
        assert shown[name]._repr_html_() == shown[name]._repr_html_()

    def test_a_long_fit_is_thinned(self):
        n = 5000
        values = np.linspace(1.0, 2.0, n)
        html = intervals(values, values - 1.0, values + 1.0, values > 1.5, [EVIL] * n, "uu", "m² s⁻²")
        assert len(html) < MOST + 100 * 60  # of the long name of each
        assert len(some(n)) == 80
        assert 'fill="url(#hatch-' in html

    def test_records_are_xarray_s(self, found):
        """What a Dataset shows of itself is what its users know; nothing of ours is in its way."""
        assert "xr-header" in found.records._repr_html_()


class TestPictures:
    def test_a_beam_to_the_right_is_on_the_right_and_one_above_is_above(self):
        drawn = ET.fromstring(beams([1.0, 0.0], [0.0, 1.0], ["right", "up"], "beams"))  # noqa: S314 - our own
        (right, up) = (
            (float(one.get("cx")), float(one.get("cy"))) for one in drawn.iter() if one.tag.endswith("circle")
        )
        assert right[0] > up[0]
        assert right[1] > up[1]  # SVG counts downwards

    def test_scan_from_the_front(self):
        """The lidar looks along -x, and y is at its right."""
        html = brs.Scan(
            "right", [[-np.cos(0.3), np.sin(0.3), 0.0]], focus_distance=[9.0], beam_time=[0.0], scan_duration=1.0
        )._repr_html_()
        assert 'cx="138.0" cy="80.0"' in html

    def test_correlations_are_told_apart_by_sign_and_size(self):
        html = heat_map([[1.0, -0.25], [-0.25, 1.0]], ["0", "1"], "correlation")
        assert html.count('fill-opacity="1.00"') == 2
        assert html.count('fill="#d9730d" fill-opacity="0.25"') == 2

    def test_what_is_the_prior_s_is_hatched_and_only_that(self):
        html = bars([0.5, 0.5], [0.1, 0.1], [0.9, 0.9], ["uu", "ww"], "R", (-1.0, 1.0), priors=[False, True])
        assert html.count('fill="url(#hatch-') == 1
        assert html.index('fill="#0f7fc4"') < html.index('fill="url(#hatch-')

    def test_what_is_not_known_is_left_out(self):
        missing = [np.nan, np.nan]
        assert intervals(missing, missing, missing, [True, True], ["a", "b"], "uu", "m² s⁻²").count("<g>") == 0

    def test_ranges(self):
        rows = [
            {"quantity": name, "range": at, "estimate": 0.1, "low": 0.05, "high": 0.2, "decided": 0.9, "of": "campaign"}
            for name in ("ti", "uu")
            for at in (80.0, 120.0)
        ]
        html = ranges_card(pd.DataFrame(rows), EVIL, ["range 80 m", "range 120 m"])
        assert html.count("<g>") == 2
        assert "uu at 120 m" in html
        assert "<script" not in html
        assert "none" in ranges_card(pd.DataFrame(), "6-beam", ["range 80 m"])

    def test_a_card_without_a_picture(self):
        assert "<svg" not in card("title", [("name", "value")])


class TestText:
    def test_a_scan(self):
        assert repr(SCAN) == (
            "<Scan '6-beam': beams 6, 0 to 15° from straight ahead, distance 98 m, cycle 1 s, probe points>"
        )

    def test_a_fit_says_what_is_the_prior_s(self, found):
        lines = repr(found).splitlines()
        assert lines[0] == "<Fit: 2 of 3 records, scan 6-beam, sampler emcee"
        assert lines[1] == " from: 2020-01-01T00:00 to 2020-01-01T00:20 (UTC)"
        summary = found.summary(columns=["stress", "median", "decided"]).groupby("stress").median()
        for line in lines[4:]:
            name, said = line.strip(" >").split(": ")
            assert said.split(",")[0] == f"{summary.loc[name, 'median']:.3g}"
            assert said.endswith("(the prior's)") == (summary.loc[name, "decided"] < 0.5)
        assert len(lines) == 10

    def test_priors_with_arrays_say_them_in_words(self, shown):
        assert repr(shown["gaussian"]).startswith("<GaussianPrior: gaussian: normal with mean (1, 0.6, 0.4,")

    def test_priors_of_a_few_numbers_can_be_typed_again(self, shown):
        from bayes_rs.priors import FlatPrior, WeakPrior  # noqa: PLC0415 - for eval

        for name in ("prior", "flat"):
            again = eval(repr(shown[name]), {"WeakPrior": WeakPrior, "FlatPrior": FlatPrior})  # noqa: S307 - our own
            assert again == shown[name]


def test_no_plotting_library_is_loaded():
    code = (
        "import sys, bayes_rs as brs\nscan = brs.load_scan('2-beam')\nscan._repr_html_()\n"
        "brs.load_turbulence('fu-2022')._repr_html_()\nbrs.priors.make_prior('weak')._repr_html_()\n"
        "print(sorted({'matplotlib', 'arviz', 'pandas', 'xarray', 'pyarrow', 'IPython'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603 - our own
    assert done.stdout == "[]\n"
