"""Boxes for simulators of loads: read back by readers of their own, they have the stresses that were asked for."""

from __future__ import annotations

import json
import struct
import sys

import click
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import bayes_rs as brs
from bayes_rs.cli.boxes_command import boxes
from bayes_rs.cli.group import commands
from bayes_rs.errors import InputError, MissingExtraError
from bayes_rs.fits.load_boxes import record_grid
from bayes_rs.simulation import BoxGrid, box_stresses, export_box
from bayes_rs.simulation.box_files import FORMATS
from bayes_rs.simulation.load_box import turning_factor, with_stresses

pytest.importorskip("hipersim", reason="boxes of Mann turbulence need hipersim")

STRESSES = np.array([1.4, 0.9, 0.4, 0.2, -0.3, 0.1])
GRID = BoxGrid((128, 10, 8), (10.0, 6.0, 5.0))
SPEED, HUB = 9.0, 60.0
FLOAT = 1e-6  # of float32, relative to the largest stress
INT16 = 2e-5  # of a thousandth of a standard deviation, rounded, at most: 1/12 of 1e-6, and means of rounding errors


def read_hawc2(folder, shape):
    """Three files of float32, z fastest."""
    return np.stack([np.fromfile(folder / f"box-000{name}.turb", dtype="<f4").reshape(shape) for name in "uvw"])


def read_bladed(file):
    """As Bladed lays it out: header of the improved von Karman model, int16 by step, z, y and component."""
    content = file.read_bytes()
    head = struct.unpack_from("<hhi6f", content, 0)
    assert head[:3] == (-99, 4, 3)
    z_ref, intensity = head[5], np.array(head[6:9])
    d_z, d_y, d_x, half, mean, *_ = struct.unpack_from("<3fi4f", content, 32)
    _, _, n_z, n_y = struct.unpack_from("<4i", content, 64)
    raw = np.frombuffer(content, dtype="<i2", offset=104).reshape(2 * half, n_z, n_y, 3)
    value = raw * (0.001 * mean * intensity / 100.0)
    return value.transpose(3, 0, 2, 1), (d_x, d_y, d_z), mean, z_ref, intensity


def read_turbsim(file):
    """As OpenFAST's InflowWind reads it: (value - offset) / slope, by step, z, y and component."""
    content = file.read_bytes()
    head = struct.unpack_from("<h4i6f", content, 0)
    scale = np.array(struct.unpack_from("<6f", content, 42), dtype=np.float64).reshape(3, 2)
    (length,) = struct.unpack_from("<i", content, 66)
    kind, n_z, n_y, n_tower, n_step, d_z, d_y, d_t, mean, hub, bottom = head
    assert (kind, n_tower) == (8, 0)
    raw = np.frombuffer(content, dtype="<i2", offset=70 + length).reshape(n_step, n_z, n_y, 3)
    value = (raw - scale[:, 1]) / scale[:, 0]
    return value.transpose(3, 0, 2, 1), (d_t * mean, d_y, d_z), mean, hub, bottom, 1.0 / scale[:, 0]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The same box in every format."""
    place = tmp_path_factory.mktemp("boxes")
    for name in ("hawc2", "bladed", "turbsim", "netcdf"):
        export_box(STRESSES, place / name, grid=GRID, wind_speed=SPEED, seed=3, format=name, hub_height=HUB)
    return place


@pytest.fixture(scope="module")
def box(written):
    return read_hawc2(written / "hawc2", GRID.shape)


class TestRoundTrip:
    def test_hawc2(self, box):
        np.testing.assert_allclose(box_stresses(box), STRESSES, atol=FLOAT * STRESSES[0])

    def test_netcdf(self, written, box):
        with xr.open_dataset(written / "netcdf" / "box-000.nc", engine="h5netcdf") as data:
            velocity = data["velocity"].load()
        assert velocity.dims == ("uvw", "x", "y", "z")
        assert velocity.values.tobytes() == np.ascontiguousarray(box).tobytes()
        np.testing.assert_allclose(velocity.attrs["stresses"], STRESSES)
        for name, step in zip("xyz", GRID.spacing, strict=True):
            np.testing.assert_allclose(np.diff(velocity[name]), step)

    def test_bladed(self, written, box):
        """With v to the right, and the planes in the order in which they arrive."""
        value, spacing, mean, hub, _ = read_bladed(written / "bladed" / "box-000.wnd")
        np.testing.assert_allclose([*spacing, mean, hub], [*GRID.spacing, SPEED, HUB], rtol=1e-6)
        ours = value[:, ::-1] * np.array([1.0, -1.0, 1.0])[:, None, None, None]
        np.testing.assert_allclose(box_stresses(ours), STRESSES, atol=INT16 * STRESSES[0])
        step = 1e-3 * box.std(axis=(1, 2, 3))
        assert np.all(np.abs(ours - box).max(axis=(1, 2, 3)) < 0.51 * step)

    def test_bladed_by_the_reader_of_the_generator(self, written, box):
        hipersim = pytest.importorskip("hipersim._hipersim")
        field = hipersim.TurbulenceField.from_bladed(written / "bladed" / "box-000.wnd")
        ours = field.uvw[:, ::-1] - np.array([SPEED, 0.0, 0.0])[:, None, None, None]
        np.testing.assert_allclose(ours[0], box[0], atol=2e-3 * box[0].std())
        np.testing.assert_allclose(-ours[1], box[1], atol=2e-3 * box[1].std())

    def test_the_summary_beside_it_is_what_openfast_looks_for(self, written):
        lines = (written / "bladed" / "box-000.sum").read_text().splitlines()
        assert lines[0] == "F  CLOCKWISE"
        assert float(lines[1].split()[0]) == HUB
        assert float(lines[2].partition("=")[2].split()[0]) == SPEED
        value, _, _, _, intensity = read_bladed(written / "bladed" / "box-000.wnd")
        told = [float(line.partition("=")[2].strip(" %")) for line in lines[3:6]]
        np.testing.assert_allclose(told, intensity, rtol=1e-6)
        # with half a thousandth for rounding
        np.testing.assert_allclose(told, 100.0 * value.std(axis=(1, 2, 3)) / SPEED, rtol=5e-4)
        assert lines[-1].strip() == "BLADED LEFT-HAND RULE"

    def test_turbsim(self, written, box):
        value, spacing, mean, hub, bottom, step = read_turbsim(written / "turbsim" / "box-000.bts")
        np.testing.assert_allclose([*spacing, mean, hub], [*GRID.spacing, SPEED, HUB], rtol=1e-6)
        assert bottom == pytest.approx(HUB - 0.5 * 7 * 5.0)
        ours = value[:, ::-1] - np.array([SPEED, 0.0, 0.0])[:, None, None, None]
        np.testing.assert_allclose(box_stresses(ours), STRESSES, atol=INT16 * STRESSES[0])
        assert np.all(np.abs(ours - box).max(axis=(1, 2, 3)) < 0.6 * step)

    def test_turbsim_holds_the_shear(self, tmp_path, box):
        export_box(
            STRESSES,
            tmp_path / "box",
            grid=GRID,
            wind_speed=SPEED,
            seed=3,
            format="turbsim",
            hub_height=HUB,
            shear_exponent=0.2,
        )
        value, *_ = read_turbsim(tmp_path / "box" / "box-000.bts")
        height = HUB + 5.0 * (np.arange(8) - 3.5)
        mean = (value[0] - box[0][::-1]).mean(axis=(0, 1))
        np.testing.assert_allclose(mean, SPEED * (height / HUB) ** 0.2, atol=1e-4)

    def test_the_section_for_hawc2_says_that_nothing_is_scaled(self, written):
        text = (written / "hawc2" / "box-000.htc").read_text()
        assert "box_dim_v 10 6;" in text
        assert "dont_scale 1;" in text

    def test_an_ensemble_tensor_is_about_zero(self, tmp_path):
        export_box(STRESSES, tmp_path / "box", grid=GRID, wind_speed=SPEED, seed=3, target="ensemble")
        found = read_hawc2(tmp_path / "box", GRID.shape)
        np.testing.assert_allclose(box_stresses(found, target="ensemble"), STRESSES, atol=FLOAT * STRESSES[0])
        assert box_stresses(found)[0] < STRESSES[0]


class TestFactor:
    def test_it_is_symmetric_and_turns_one_tensor_into_the_other(self):
        rng = np.random.default_rng(1)
        for _ in range(50):
            has, wanted = (root @ root.T for root in rng.normal(size=(2, 3, 3)))
            factor = turning_factor(has, wanted)
            np.testing.assert_allclose(factor, factor.T, atol=1e-9 * np.abs(factor).max())
            np.testing.assert_allclose(factor @ has @ factor.T, wanted, atol=1e-9 * np.abs(wanted).max())

    def test_no_other_changes_the_velocities_less(self):
        """Olkin and Pukelsheim (1982): among all T with T B Tᵀ = R the trace of T B is largest."""
        rng = np.random.default_rng(2)
        has, wanted = (root @ root.T for root in rng.normal(size=(2, 3, 3)))
        best = np.trace(turning_factor(has, wanted) @ has)
        cholesky = np.linalg.cholesky(wanted) @ np.linalg.inv(np.linalg.cholesky(has))
        for _ in range(200):
            turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            other = np.linalg.cholesky(wanted) @ turn @ np.linalg.inv(np.linalg.cholesky(has))
            np.testing.assert_allclose(other @ has @ other.T, wanted, atol=1e-9)
            assert np.trace(other @ has) <= best + 1e-9
        assert np.trace(cholesky @ has) < best

    def test_turning_the_axes_turns_the_result(self):
        rng = np.random.default_rng(3)
        has, wanted = (root @ root.T for root in rng.normal(size=(2, 3, 3)))
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turned = turning_factor(turn @ has @ turn.T, turn @ wanted @ turn.T)
        np.testing.assert_allclose(turned, turn @ turning_factor(has, wanted) @ turn.T, atol=1e-9)

    def test_its_own_tensor_leaves_a_box_as_it_is(self, box):
        again = with_stresses(box, box_stresses(box))
        np.testing.assert_allclose(again, box, atol=1e-5)


class TestDirections:
    def test_the_mann_box_leans_forward_with_height(self):
        """x along the wind: eddies that the shear has stretched reach a point above before one below.

        So u above at a place is most like u below at a smaller x, as hipersim says of its axes.
        """
        grid = BoxGrid((256, 16, 16), (8.0, 8.0, 8.0))
        above = []
        for seed in range(4):
            made = brs.simulation.load_box.hipersim_for("").MannTurbulenceField.generate(
                0.05, 60.0, 3.5, grid.shape, grid.spacing, seed=seed, HighFreqComp=1, n_cpu=1
            )
            u = np.asarray(made.uvw)[0]
            spectrum = np.fft.rfft(u, axis=0)
            cross = (spectrum[1:12, :, 12] * spectrum[1:12, :, 4].conj()).sum()
            above.append(np.angle(cross))
        # e^{ik(x - d)} above for e^{ikx} below has the phase -kd, with d > 0 where what is above is farther along
        assert np.mean(above) < -3.0 * np.std(above) / np.sqrt(len(above))


@pytest.fixture(scope="module")
def records():
    return brs.make_records(brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1), "2-beam")


@pytest.fixture(scope="module")
def fit(records):
    return brs.fit(records, "2-beam", noise=brs.noise.calibrate("2-beam", wind_speed=10.0), seed=1)


class TestDrawsOfAFit:
    def test_each_box_has_the_stresses_of_its_draw(self, fit, tmp_path):
        boxes = brs.export_boxes(fit, 1, tmp_path / "boxes", grid=GRID, seed=5, n_box=3, format="netcdf")
        draws = fit.draws(1).reshape(-1, 6)
        names = list(brs.STRESSES)
        for row in boxes.itertuples():
            np.testing.assert_array_equal(draws[row.draw], boxes.loc[row.Index, names].to_numpy(dtype=float))
            with xr.open_dataset(tmp_path / "boxes" / row.file, engine="h5netcdf") as data:
                velocity = data["velocity"].load()
            np.testing.assert_allclose(box_stresses(velocity.values), draws[row.draw], atol=FLOAT * draws[row.draw][0])
            assert velocity.attrs["L"] == row.length_scale == 61.0
            assert velocity.attrs["Gamma"] == row.gamma == 3.2
        assert boxes["seed"].nunique() == boxes["draw"].nunique() == 3
        kept = pd.read_csv(tmp_path / "boxes" / "boxes.csv")
        np.testing.assert_allclose(kept[names], boxes[names])
        assert boxes["wind_speed"].iloc[0] == float(fit.records["wind_speed"][1])

    def test_the_length_scale_is_drawn_where_the_fit_averaged_over_it(self, records, tmp_path):
        noise = brs.noise.calibrate("2-beam", wind_speed=10.0, length_scale=[30.0, 120.0], tolerance=0.1)
        own = records.assign(
            length_scale=("record", [50.0, 60.0]),
            length_scale_log_sd=("record", [0.3, 0.2]),
        )
        found = brs.fit(own, "2-beam", noise=noise, seed=1, sampler="direct", target_ess=200)
        small = BoxGrid((16, 4, 4), (50.0, 20.0, 20.0))
        boxes = brs.export_boxes(found, 0, tmp_path / "boxes", grid=small, seed=5, n_box=60, format="turbsim")
        log = np.log(boxes["length_scale"] / 50.0)
        assert abs(log.mean()) < 4.0 * 0.3 / np.sqrt(60.0)
        assert 0.2 < log.std() < 0.4
        one = brs.export_boxes(found, 0, tmp_path / "one", grid=small, seed=5, n_box=2, length_scale=80.0, gamma=2.0)
        assert one["length_scale"].tolist() == [80.0, 80.0]
        assert one["gamma"].tolist() == [2.0, 2.0]
        isotropic = brs.export_boxes(found, 0, tmp_path / "isotropic", grid=small, seed=5, n_box=1, gamma=0.0)
        assert isotropic["gamma"].tolist() == [0.0]

    def test_the_same_seed_writes_the_same_bytes(self, fit, tmp_path):
        for name in ("a", "b"):
            brs.export_boxes(fit, 0, tmp_path / name, grid=GRID, seed=5, n_box=1, format="turbsim")
        assert (tmp_path / "a" / "box-000.bts").read_bytes() == (tmp_path / "b" / "box-000.bts").read_bytes()

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"n_box": 0}, "n_box"),
            ({"n_box": 10**6}, "the record has .* draws; write fewer"),
            ({"length_scale": -1.0}, "length_scale"),
            ({"format": "wind"}, "format of a box"),
        ],
    )
    def test_what_is_refused(self, fit, tmp_path, options, words):
        with pytest.raises(InputError, match=words):
            brs.export_boxes(fit, 0, tmp_path / "boxes", **{"grid": GRID, "seed": 1, **options})
        assert not (tmp_path / "boxes").exists()


@pytest.fixture(scope="module")
def folder(records, tmp_path_factory):
    place = tmp_path_factory.mktemp("command") / "fit"
    noise = brs.noise.calibrate("2-beam", wind_speed=10.0)
    brs.fit(records, "2-beam", noise=noise, seed=1, target_ess=100, output=place)
    return place


class TestDefaultGrid:
    def test_it_is_as_long_as_the_record(self, fit):
        grid = record_grid(fit, 1)
        np.testing.assert_allclose(grid.size, (600.0 * float(fit.records["wind_speed"][1]), 160.0, 160.0))
        assert grid.shape == (2048, 32, 32)
        other = record_grid(fit, 1, points=(64, 4, 6), size=(90.0, 120.0), length=500.0)
        np.testing.assert_allclose(other.spacing, (500.0 / 64, 90.0 / 4, 120.0 / 6))

    def test_boxes_take_it(self, fit, tmp_path):
        brs.export_boxes(fit, 1, tmp_path / "boxes", seed=1, n_box=1, format="netcdf")
        with xr.open_dataset(tmp_path / "boxes" / "box-000.nc", engine="h5netcdf") as data:
            assert data["velocity"].shape == (3, 2048, 32, 32)
            assert float(data["x"][-1]) == pytest.approx(record_grid(fit, 1).size[0] * 2047 / 2048)


class TestCommand:
    """`bayes-rs boxes` writes what `export_boxes` does."""

    SMALL = ("--points", 64, 8, 6, "--boxes", 2)

    @staticmethod
    def run(*words):
        return CliRunner().invoke(commands, ["boxes", *map(str, words)])

    @pytest.mark.parametrize("name", list(FORMATS))
    def test_the_same_bytes_as_in_python(self, name, folder, tmp_path):
        shear = ("--shear-exponent", 0.2) if name == "turbsim" else ()
        more = ("--length", 900, "--size", 80, 90, "--length-scale", 50, "--gamma", 2.5, "--hub-height", 70)
        words = (*self.SMALL, "--record", 1, "--seed", 7, "--format", name, *more, *shear, "-o", tmp_path / "a")
        done = self.run(folder, *words)
        assert done.exit_code == 0, done.output
        brs.export_boxes(
            brs.open_fit(folder),
            1,
            tmp_path / "b",
            grid=BoxGrid((64, 8, 6), (900.0 / 64, 10.0, 15.0)),
            seed=7,
            n_box=2,
            format=name,
            length_scale=50.0,
            gamma=2.5,
            hub_height=70.0,
            shear_exponent=0.2 if shear else 0.0,
        )
        one, other = (sorted(path for path in (tmp_path / place).iterdir()) for place in "ab")
        assert [path.name for path in one] == [path.name for path in other]
        for path, expected in zip(one, other, strict=True):
            if path.suffix == ".nc":
                xr.testing.assert_identical(xr.load_dataset(path), xr.load_dataset(expected))
            elif path.name != "fingerprints.jsonl":
                assert path.read_bytes() == expected.read_bytes(), path.name

    def test_it_says_what_they_are_of(self, folder, tmp_path):
        done = self.run(folder, *self.SMALL, "-o", tmp_path / "out")
        first, heading, *rows = done.output.splitlines()
        speed = float(brs.open_fit(folder).records["wind_speed"][0])
        assert first.startswith(
            f"2 boxes of record 0, wind {speed:.2f} m/s: {600 * speed:.5g} × 160 × 160 m, 64 × 8 × 6"
        )
        assert heading.split() == ["file", *brs.STRESSES, "L"]
        assert rows[1].split()[0] == "box-001u.turb"
        assert rows[2].startswith("in this record the beams measured uu, uv, and so TI; vv, ww, uw, vw are mostly")
        assert rows[-1].endswith(str(tmp_path / "out"))
        table = pd.read_csv(tmp_path / "out" / "boxes.csv")
        again = self.run(folder, *self.SMALL, "-o", tmp_path / "out", "--overwrite", "--json")
        told = json.loads(again.output)
        assert told["folder"] == str(tmp_path / "out")
        assert told["grid"]["points"] == [64, 8, 6]
        np.testing.assert_allclose([box["uu"] for box in told["boxes"]], table["uu"])
        assert told["decided"]["vv"] < 0.5 < told["decided"]["uu"]

    def test_an_existing_folder_is_kept(self, folder, tmp_path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine").write_text("mine")
        for more in ((), ("--overwrite",)):
            assert isinstance(self.run(folder, *self.SMALL, "-o", tmp_path / "out", *more).exception, InputError)
        assert (tmp_path / "out" / "mine").read_text() == "mine"

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (("--record", 9), "No record 9: there are 2"),
            (("--points", 63, 8, 6), "every number must be even"),
            (("--boxes", 10**6), "draws; write fewer boxes"),
            (("--shear-exponent", 0.2), "its files hold no mean wind"),
            (("--hub-height", 10), "into the ground"),
            (("--range", 50), "is of one range"),
        ],
    )
    def test_what_is_refused(self, words, message, folder, tmp_path):
        done = self.run(folder, *self.SMALL, *words, "-o", tmp_path / "out")
        assert isinstance(done.exception, InputError)
        assert message in str(done.exception)
        assert not (tmp_path / "out").exists()

    def test_its_formats_are_those_that_there_are(self):
        option = next(one for one in boxes.params if "--format" in one.opts)
        assert tuple(option.type.choices) == tuple(FORMATS)
        assert [item.value for item in option.shell_complete(click.Context(boxes), "tu")] == ["turbsim"]

    def test_a_bar_is_shown_where_it_is_asked_for(self, fit, tmp_path, capsys):
        for shown in (True, False):
            brs.export_boxes(fit, 0, tmp_path / f"{shown}", grid=GRID, seed=1, n_box=2, progress=shown)
            assert ("boxes:" in capsys.readouterr().err) is shown


class TestRefused:
    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"stresses": [1.0, 1.0, 1.0, 1.5, 0.0, 0.0]}, "no flow has them"),
            ({"stresses": [1.0, 0.0, 1.0, 0.0, 0.0, 0.0]}, "no flow has them"),
            ({"stresses": [1.0, 1.0]}, "stresses"),
            ({"grid": (8, 8, 8)}, "Invalid grid"),
            ({"wind_speed": 0.0}, "wind_speed"),
            ({"target": "mean"}, "target"),
            ({"hub_height": 5.0}, "into the ground"),
            ({"shear_exponent": 0.2}, "the simulator adds the shear"),
            ({"grid": BoxGrid((2**20, 4096, 4096), (1.0, 1.0, 1.0))}, "memory"),
        ],
    )
    def test_in_one_line(self, tmp_path, options, words):
        given = {"stresses": STRESSES, "grid": GRID, "wind_speed": SPEED, "seed": 1, **options}
        with pytest.raises(InputError, match=words):
            export_box(given.pop("stresses"), tmp_path / "box", **given)
        assert not (tmp_path / "box").exists()

    def test_an_existing_folder_is_kept(self, tmp_path):
        export_box(STRESSES, tmp_path / "box", grid=GRID, wind_speed=SPEED, seed=1)
        with pytest.raises(InputError):
            export_box(STRESSES, tmp_path / "box", grid=GRID, wind_speed=SPEED, seed=1)
        export_box(STRESSES, tmp_path / "box", grid=GRID, wind_speed=SPEED, seed=1, overwrite=True)

    def test_without_hipersim_the_extra_is_named(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "hipersim", None)
        with pytest.raises(MissingExtraError, match=r'pip install "bayes_rs\[boxes\]"\.'):
            export_box(STRESSES, tmp_path / "box", grid=GRID, wind_speed=SPEED, seed=1)
        assert not (tmp_path / "box").exists()

    def test_what_is_no_box_has_no_stresses(self):
        with pytest.raises(InputError, match="velocity"):
            box_stresses(np.zeros((3, 4, 2)))
        with pytest.raises(InputError, match="target"):
            box_stresses(np.zeros((3, 4, 2, 2)), target="mean")
