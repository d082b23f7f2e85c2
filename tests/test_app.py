"""The app without a browser: what its pages calculate, what can be opened, and who is refused."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from report_scene import result_folder

import bayes_rs as brs
from bayes_rs.app import choosing
from bayes_rs.app.choosing import PRESETS, SCAN_SLIDERS, Answers, FlowChoice, ScanChoice, answer, prior_widths_at
from bayes_rs.app.guard import Guard
from bayes_rs.app.latest import Latest
from bayes_rs.app.opening import open_place, place_below, places, with_fit
from bayes_rs.app.server import listen
from bayes_rs.design.scene import DrawnPrior, Scene, try_scene
from bayes_rs.fits.settings import Settings
from bayes_rs.priors.registry import make_prior
from bayes_rs.spectra.spectra_job import run_spectra

pytest.importorskip("dash", reason="NOT TESTED: dash is not installed; pip install 'bayes_rs[app]'")

SCRIPT = Path(sys.executable).parent / "bayes-rs"


@pytest.fixture(scope="module")
def mine():
    return answer(ScanChoice(), FlowChoice())


class TestScene:
    def test_draws_are_bit_by_bit_those_of_a_fit(self):
        scan, flow = brs.load_scan("6-beam", opening_angle_deg=30.0), brs.load_turbulence("fu-2022")
        scene = Scene.at(scan, flow, wind_speed=10.0, duration=600.0)
        records = scene.records("fast", 4, 1)
        found = try_scene(records, scene, DrawnPrior.of(make_prior("weak")), seed=3)
        fitted = brs.fit(
            records, scan, noise=scene.noise, seed=3, sampler="auto", draws="float64", campaign="off", progress=False
        )
        assert np.array_equal(found.draws, fitted.draws())
        decided = fitted.of_stresses("decided")["decided"]
        np.testing.assert_allclose(found.decided, decided, rtol=0.0, atol=1e-12)  # the same sums, stored and read


class TestChoosing:
    def test_widths_are_those_of_compare_within_their_error(self, mine):
        flow = FlowChoice().turbulence()
        table = brs.compare(ScanChoice().scan(), turbulence=flow, estimators=(), n_records=128)
        four_sigmas = 4.0 * mine.error  # of the mean over 32 records; that over 128 is known twice as well
        assert np.all(np.abs(mine.width - table["width_90"].to_numpy()) < four_sigmas)
        assert np.all(mine.error < 0.12 * mine.width)

    def test_a_wider_cone_knows_vv_and_ww_better(self, mine):
        wider = answer(ScanChoice(opening_angle_deg=45.0), FlowChoice())
        assert np.all(wider.width[1:3] < mine.width[1:3])
        assert wider.learnt > mine.learnt

    def test_a_longer_record_narrows_uu(self, mine):
        longer = answer(ScanChoice(), FlowChoice(duration=1800.0))
        assert longer.width[0] < 0.8 * mine.width[0]  # errors go with the root of the record, which is 3 times as long

    @pytest.mark.parametrize("uu", [0.3, 1.4, 4.0])
    def test_the_flow_has_the_variance_that_was_asked_for(self, uu):
        flow = FlowChoice(uu=uu, gamma=2.0)
        assert flow.turbulence().stresses()[0] == pytest.approx(uu, rel=1e-12)
        assert flow.intensity == pytest.approx(np.sqrt(uu) / 10.0)

    def test_beams_are_those_asked_for(self):
        assert ScanChoice(n_beams=9).scan().n_beam == 9
        assert ScanChoice(n_beams=5, centre=False).scan().n_beam == 5

    def test_unseen_stresses_are_the_priors(self):
        staring = answer(ScanChoice(n_beams=1, centre=False, opening_angle_deg=5.0), FlowChoice())
        assert not staring.of_prior[0]
        assert staring.of_prior[1:] == [True] * 5

    def test_the_prior_at_a_size_grows_with_it(self):
        truth = np.array([1.0, 0.6, 0.4, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(prior_widths_at(3.0 * truth), 3.0 * prior_widths_at(truth), rtol=1e-12)

    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({"opening_angle_deg": 80.0}, "Half-cone opening angle goes from 5 to 60 °"),
            ({"opening_angle_deg": "wide"}, "Invalid opening_angle_deg 'wide'"),
            ({"focus_distance": None}, "Invalid focus_distance None"),
            ({"n_beams": 1}, "with a beam along the axis there are at least 2"),
            ({"n_beams": float("nan")}, "Beams, all goes from 1 to 50"),
        ],
    )
    def test_no_scan_but_those_of_the_sliders(self, values, words):
        with pytest.raises(brs.InputError, match=words):
            ScanChoice(**values)

    @pytest.mark.parametrize("values", [{"gamma": 3.3}, {"wind_speed": 0.0}, {"uu": True}, {"duration": 1e9}])
    def test_no_flow_but_those_of_the_sliders(self, values):
        with pytest.raises(brs.InputError, match=f"Invalid {next(iter(values))}"):
            FlowChoice(**values)

    def test_sliders_reach_their_ends(self):
        for slider in SCAN_SLIDERS[:3]:
            for value in (slider.low, slider.high):
                assert getattr(ScanChoice(**{slider.name: value}, centre=False), slider.name) == value

    def test_a_preset_that_is_none(self):
        with pytest.raises(brs.InputError, match=f"choose of {PRESETS[0]}"):
            answer("zx-tm", FlowChoice())

    def test_answers_are_kept(self, monkeypatch):
        asked = []
        monkeypatch.setattr(choosing, "answer", lambda scan, flow: asked.append((scan, flow)) or "found")
        kept, flow = Answers(), FlowChoice()
        assert kept.known("6-beam", flow) is None
        assert [kept.get("6-beam", flow), kept.get("6-beam", flow), kept.known("6-beam", flow)] == ["found"] * 3
        assert len(asked) == 1
        for uu in np.arange(0.1, 5.0, 0.05).round(3):
            kept.get("6-beam", FlowChoice(uu=uu))
        assert kept.known("6-beam", flow) is None  # the oldest goes


class TestScanPage:
    def test_presets_follow_the_corner_plot_and_only_while_the_page_shows_their_scan(self):
        from bayes_rs.app.scan_page import _SLIDERS, ScanPage  # noqa: PLC0415 - where Dash is installed
        from bayes_rs.app.site import Site, no_update  # noqa: PLC0415 - as above

        page = ScanPage(Site())
        page._ready.set()  # nothing is made ahead
        first = {**vars(ScanChoice()), **vars(FlowChoice())}

        def asked(**changed):
            return [*({**first, **changed}[slider.name] for slider in _SLIDERS), ["centre"], ["2-beam"], 1, "light"]

        assert [one["name"] for one in page.follow(asked(), "me")[0]["data"]][1:] == [
            "this scan, with the Monte-Carlo error"
        ]
        chart, waiting = page.posterior(asked(), "me")
        assert len(chart["data"]) == 7
        page.follow(asked(opening_angle_deg=31), "me")
        assert page.compare(waiting, "me") == (no_update,) * 3
        page.follow(asked(), "me")
        assert page.compare(waiting, "me")[0]["data"][1]["name"] == "2-beam"
        assert page.posterior(asked(), "me")[1] is no_update  # it is known by now


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    folder = tmp_path_factory.mktemp("start")
    result_folder(folder / "fits" / "hour", n_record=3)
    shutil.copy(brs.demo_file("6-beam-45"), folder / "<b>six.parquet")
    (folder / "notes.md").write_text("not data")
    (folder / ".hidden").mkdir()
    shutil.copy(brs.demo_file("6-beam"), folder / ".hidden" / "six.parquet")
    outside = folder.parent / f"{folder.name}-elsewhere.parquet"
    shutil.copy(brs.demo_file("6-beam"), outside)
    (folder / "link.parquet").symlink_to(outside)
    return folder


SETTINGS = Settings().changed(scan="6-beam", opening_angle_deg=45.0, focus_distance=[52.0])


def content_of(folder):
    return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in sorted(folder.rglob("*"))}


class TestOpening:
    def test_places_are_results_first(self, start):
        assert places(start)[0] == str(Path("fits") / "hour")
        assert "<b>six.parquet" in places(start)
        assert not any("hidden" in one or one.endswith((".md", "records.nc")) for one in places(start))

    @pytest.mark.parametrize("name", ["..", "../..", "/etc/passwd", "link.parquet", "fits/../../x"])
    def test_nothing_elsewhere_is_opened(self, start, name):
        with pytest.raises(brs.InputError, match=r"is not below .* where the app was begun"):
            place_below(start, name)

    @pytest.mark.parametrize(
        ("name", "words"), [("", "Nothing is named"), ("a\0b", "Nothing"), ("no", "does not exist")]
    )
    def test_what_is_not_there(self, start, name, words):
        with pytest.raises(brs.InputError, match=words):
            place_below(start, name)

    def test_a_fit(self, start):
        before = content_of(start)
        found = open_place(place_below(start, "fits/hour"), "hour", SETTINGS, "", "")
        assert found.n_record == len(found.record_names) == 3
        assert found.fit.n_fitted == 2
        assert found.spectra is None
        assert content_of(start) == before

    def test_a_file_and_its_fit(self, start):
        before = content_of(start)
        found = open_place(place_below(start, "<b>six.parquet"), "<b>six", SETTINGS, "", "")
        assert (found.n_record, found.scan.n_beam, found.fit) == (6, 6, None)
        assert found.spectra.sizes["record"] == 6
        fitted = with_fit(found, SETTINGS)
        assert fitted.fit.n_fitted == 6
        assert fitted.fit.has_draws
        assert content_of(start) == before
        with pytest.raises(brs.InputError, match="no records here"):
            with_fit(fitted, SETTINGS)

    def test_a_mast_and_motion_of_the_settings_stand_in_the_records(self, start, tmp_path):
        plain = open_place(place_below(start, "<b>six.parquet"), "six", SETTINGS, "", "").records
        pd.DataFrame({"time": plain["time"].values, "uu": 1.1}).to_csv(tmp_path / "mast.csv", index=False)
        pd.DataFrame({"time": plain["time"].values + np.timedelta64(60, "s"), "tilt_deg": 0.5}).to_csv(
            tmp_path / "motion.csv", index=False
        )
        settings = SETTINGS.changed(
            mast=(str(tmp_path / "mast.csv"),),
            mast_position=(-80.0, 10.0, 0.0),
            motion=(str(tmp_path / "motion.csv"),),
            motion_columns={"time": "time", "tilt_deg": "tilt_deg"},
        )
        found = open_place(place_below(start, "<b>six.parquet"), "six", settings, "", "")
        np.testing.assert_allclose(found.records["mast_stress"].values[:, 0], 1.1)
        np.testing.assert_allclose(found.records["tilt"].values, 0.5)
        assert "a mast at (-80, 10, 0) m is data of the fit: it has stresses of 6 of 6 records of 600 s" in found.lines
        assert "tilt and roll from 1 files, of 6 of 6 records" in found.lines
        assert with_fit(found, settings).fit.n_fitted == 6

    def test_a_file_without_a_scan(self, start):
        with pytest.raises(brs.InputError, match="The scan of 'six' is not known: choose one"):
            open_place(place_below(start, "<b>six.parquet"), "six", Settings(), "", "")

    def test_what_is_no_data(self, start):
        with pytest.raises(brs.InputError):
            open_place(place_below(start, "notes.md"), "notes.md", SETTINGS, "", "")

    def test_the_folder_of_spectra(self, tmp_path):
        scan = brs.load_scan("staring")
        series = brs.simulate(scan, "fu-2022", wind_speed=10.0, n_records=2, seed=1)
        run_spectra(series, brs.make_records(series, scan), scan, tmp_path / "spectra")
        found = open_place(tmp_path / "spectra", "spectra", SETTINGS, "", "")
        assert (found.kind, found.n_record, found.scan.n_beam) == ("spectra of records", 2, 1)
        assert found.spectra_fit.sizes["record"] == found.spectra.sizes["record"] == 2


class TestLatest:
    def test_who_is_no_longer_the_newest_is_not_answered(self):
        latest, go, answers = Latest(), threading.Event(), {}
        first = threading.Thread(target=lambda: answers.update(a=latest.answer("page", lambda: go.wait(20) and "a")))
        first.start()
        others = [
            threading.Thread(target=lambda name=name: answers.update({name: latest.answer("page", lambda: name)}))
            for name in ("b", "c")
        ]
        for one in others:
            one.start()
            while latest._count < 2 + others.index(one):  # until it has asked
                time.sleep(0.001)
        go.set()
        for one in (first, *others):
            one.join(20)
        assert answers == {"a": "a", "b": None, "c": "c"}


def request(port, path="/", method="GET", body=None, **headers):
    connection = HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request(
        method, path, body=body, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )
    answered = connection.getresponse()
    return answered.status, answered.read().decode("utf-8", "replace"), dict(answered.getheaders())


class TestGuard:
    @pytest.fixture
    def refusal(self):
        guard = Guard(lambda environ, start: [], 8050, "")  # noqa: ARG005 - never asked

        def of(**changes):
            asked = {"HTTP_HOST": "127.0.0.1:8050", "REQUEST_METHOD": "GET", **changes}
            return guard.refusal({name: value for name, value in asked.items() if value is not None})

        return of

    @pytest.mark.parametrize(
        "asked",
        [
            {},
            {"HTTP_HOST": "localhost:8050"},
            {"REQUEST_METHOD": "POST", "HTTP_ORIGIN": "http://127.0.0.1:8050", "HTTP_SEC_FETCH_SITE": "same-origin"},
            {"HTTP_SEC_FETCH_SITE": "cross-site"},  # somebody's link to the app: the page is read by nobody else
        ],
    )
    def test_the_apps_own_page_is_answered(self, refusal, asked):
        assert refusal(**asked) == ""

    @pytest.mark.parametrize(
        "asked",
        [
            {"HTTP_HOST": "evil.example:8050"},
            {"HTTP_HOST": "127.0.0.1.evil.example:8050"},
            {"HTTP_HOST": "127.0.0.1:9999"},
            {"HTTP_HOST": "127.0.0.1"},
            {"HTTP_HOST": None},
            {"HTTP_ORIGIN": "http://evil.example"},
            {"HTTP_ORIGIN": "null"},
            {"HTTP_ORIGIN": "http://127.0.0.1:9999"},
            {"REQUEST_METHOD": "POST", "HTTP_SEC_FETCH_SITE": "cross-site"},
            {"REQUEST_METHOD": "POST", "HTTP_SEC_FETCH_SITE": "same-site"},
            {"REQUEST_METHOD": "PUT"},
            {"HTTP_UPGRADE": "websocket", "HTTP_ORIGIN": "http://evil.example"},
            {"HTTP_UPGRADE": "websocket", "HTTP_ORIGIN": "http://127.0.0.1:8050"},
            {"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "2000000"},
            {"REQUEST_METHOD": "POST", "CONTENT_LENGTH": "-1"},
            {"REQUEST_METHOD": "POST", "HTTP_TRANSFER_ENCODING": "chunked"},
        ],
    )
    def test_others_are_refused(self, refusal, asked):
        assert refusal(**asked).startswith("Refused: ")


class TestCommand:
    def start_app(self, *arguments):
        before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would ignore it
        try:
            running = subprocess.Popen(  # noqa: S603 - our own script
                [SCRIPT, "app", "--no-open", *map(str, arguments)],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        finally:
            signal.signal(signal.SIGINT, before)
        said = running.stdout.readline()
        assert said.startswith("the app is at http://127.0.0.1:"), said + running.stderr.read()
        return running, int(said.split(":")[2].split("/")[0])

    def test_it_answers_refuses_and_ends(self, tmp_path):
        running, port = self.start_app(tmp_path, "--port", 0)
        status, page, headers = request(port)
        assert status == 200
        assert "react-entry-point" in page
        assert "default-src 'self'" in headers["Content-Security-Policy"]
        assert request(port, Host=f"evil.example:{port}")[0] == 403
        assert request(port, Origin="http://evil.example")[0] == 403
        assert request(port, Upgrade="websocket", Connection="Upgrade", Origin="http://evil.example")[0] == 403
        posted = request(port, "/_dash-update-component", "POST", json.dumps({}), Origin="http://evil.example")
        assert posted[:2] == (403, "Refused: this request comes from another site.\n")
        taken = subprocess.run(  # noqa: S603 - our own script
            [SCRIPT, "app", "--port", str(port), tmp_path], check=False, capture_output=True, text=True, timeout=120
        )
        assert (taken.returncode, taken.stdout) == (2, "")
        assert taken.stderr == (
            f"bayes-rs: Port {port} of 127.0.0.1 is in use: choose another with --port, or 0 for any that is free.\n"
        )
        running.send_signal(signal.SIGINT)
        assert running.communicate(timeout=60) == ("stopped.\n", "")
        assert running.returncode == 0

    def test_the_system_may_end_it(self, tmp_path):
        running, port = self.start_app(tmp_path, "--port", 0)
        running.send_signal(signal.SIGTERM)
        assert running.communicate(timeout=60) == ("stopped.\n", "")
        assert running.returncode == 0
        with listen(port):
            pass  # the port is free at once

    def test_it_is_bound_to_this_machine_alone(self):
        with listen(0) as sock:
            assert sock.getsockname()[0] == "127.0.0.1"

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["--port", "70000"], "Invalid port 70000: it is at most 65535."),
            (["not-there"], "does not exist: name a folder or files that are there"),
        ],
    )
    def test_bad_input_is_one_line(self, tmp_path, arguments, words):
        done = subprocess.run(  # noqa: S603 - our own script
            [SCRIPT, "app", "--no-open", *arguments],
            check=False,
            capture_output=True,
            text=True,
            cwd=tmp_path,
            timeout=120,
        )
        assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
        assert words in done.stderr

    def test_without_the_extra_it_names_it(self, monkeypatch):
        for name in [name for name in sys.modules if name.startswith("bayes_rs.app.")]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, "dash", None)
        with pytest.raises(brs.MissingExtraError, match=r'needs the package dash: run pip install "bayes_rs\[app\]"'):
            __import__("bayes_rs.app.making")


def test_a_port_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(brs.InputError, match="is in use"):
        listen(taken.getsockname()[1])
