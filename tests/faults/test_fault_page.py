"""Texts from files in the report: shown, never run."""

import html
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from scenes import draw_variances, plain_noise, records_of

import bayes_rs as brs
from bayes_rs import MannTurbulence, load_scan
from bayes_rs.priors.ratio import WeakPrior
from bayes_rs.result_folder import seal_folder

EVIL = "<img src=x onerror=alert(1)></script><script>alert(2)</script>\"' onload='alert(3)&{{data}}"


class _Parts(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.attributes = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *pair) for pair in attrs]


def parts_of(page):
    parser = _Parts()
    parser.feed(page)
    return parser


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A fit whose every text is hostile, and the same with plain texts."""
    made = {}
    for kind, text in (("evil", EVIL), ("plain", "plain")):
        scan = replace(load_scan("6-beam"), name=text, title=text, source=text)
        noise = replace(plain_noise(scan), turbulence=MannTurbulence(0.05, 61.0, 3.2, name=text, source=text))
        stress = WeakPrior(log_sd_uu=0.5).draw(4, seed=1)
        records = records_of(draw_variances(stress, scan, noise, np.random.default_rng(2)), scan)
        records["flag"].values[2] = 1
        records = records.assign_attrs(source_files=json.dumps([text]))
        folder = tmp_path_factory.mktemp(kind) / "fit"
        brs.fit(records, scan, output=folder, noise=noise, seed=1, target_ess=100)
        run = json.loads((folder / "run.json").read_text())
        run.update({"source_files": [text], "bad_files": {text: text}, "prior": text, "status": text, text: text})
        (folder / "run.json").write_text(json.dumps(run))
        seal_folder(folder)  # as if our own run had written it
        made[kind] = folder
    return made


def test_hostile_texts_add_no_element_and_no_attribute(folders):
    pages = {kind: brs.write_report(folder, title=None).read_text() for kind, folder in folders.items()}
    evil, plain = parts_of(pages["evil"]), parts_of(pages["plain"])
    assert evil.tags == plain.tags
    assert [pair[:2] for pair in evil.attributes] == [pair[:2] for pair in plain.attributes]
    assert "onerror=" not in re.sub(r"&lt;.*?&gt;|\\u003c.*?\\u003e", "", pages["evil"]).replace(html.escape(EVIL), "")


def test_the_title_of_the_page(folders, tmp_path):
    page = brs.write_report(folders["plain"], output=tmp_path / "a.html", title=EVIL).read_text()
    other = brs.write_report(folders["plain"], output=tmp_path / "b.html", title="plain").read_text()
    assert parts_of(page).tags == parts_of(other).tags
    assert html.escape(EVIL).replace("&#x27;", "&#39;") in page.replace("&#x27;", "&#39;")


def test_the_data_of_the_page_end_no_script(folders):
    page = brs.write_report(folders["evil"], overwrite=True).read_text()
    for content in re.findall(r"<script[^>]*>(.*?)</script>", page, flags=re.DOTALL):
        assert "alert(2)" not in content or "\\u003c" in content
        assert "<script" not in content
