"""Fields of a study that are kept in files: made once, gone on with, and refused if they are others'."""

import dataclasses
import re
import sys

import numpy as np
import pytest
import seed_study_boxes
from kept_fields import Fields, read, write

import bayes_rs as brs
from bayes_rs.errors import InputError
from bayes_rs.simulation.boxes import BoxGrid
from bayes_rs.simulation.virtual import RecordState, beam_lines, sample_records

pytest.importorskip("hipersim")

GRID = BoxGrid((64, 8, 8), (40.0, 16.0, 16.0))


@pytest.fixture(scope="module")
def fields():
    scans = {
        "sonic": seed_study_boxes.sonic_scan(),
        "six": brs.load_scan("6-beam"),
        "planes": brs.load_scan("6-beam-planes"),
    }
    return Fields(scans, "fu-2022", GRID, wind_speed=10.0, shear=0.0288, durations=(200.0, 100.0))


@pytest.fixture(scope="module")
def first(fields):
    return fields.make(1)


class TestOfAField:
    def test_variances_are_those_of_each_scan_alone(self, fields, first):
        """Beams that scans share are one line of the box; the reference goes scan by scan."""
        box, of_all = fields.maker.make(1), fields.variances([first])
        for label, scan in fields.scans.items():
            state = RecordState(scan, 10.0, 0.0, 200.0)
            lines = beam_lines(box, state.focus, state.line_of_sight)
            velocity = sample_records(lines, state, GRID)[0]
            for duration in fields.durations:
                wanted = velocity[:, : round(duration / scan.scan_duration)].var(axis=1)
                # 1e-4: boxes are of single precision, and one sum over the heights is in another order
                np.testing.assert_allclose(of_all[label][duration][0], wanted, rtol=1e-4)

    def test_shared_beams_are_made_once(self, fields):
        lines, _, of_beam = fields.lines
        assert len(of_beam) == 6 + 6 + 30
        assert len(lines) == 6 + 5 * 5 + 1  # the one plane is among the five, whose axis is one line
        assert len(np.unique(of_beam)) == len(lines)

    def test_shear_changes_no_variance(self, fields, first):
        """It is a constant at each point: what is left is rounding."""
        calm = dataclasses.replace(fields, shear=0.0).make(1)
        np.testing.assert_allclose(first["variance"], calm["variance"], rtol=1e-9)

    def test_the_sonic_is_the_tensor_of_the_box_at_its_place(self, fields, first):
        back = np.linalg.inv(brs.geometry.design_matrix(fields.scans["sonic"]))
        found = fields.variances([first])["sonic"][200.0] @ back.T
        box = fields.maker.make(1)
        lines = beam_lines(box, np.zeros((3, 3)), np.eye(3))
        still = dataclasses.replace(fields.scans["sonic"].select([0, 1, 2]))
        velocity = sample_records(lines, RecordState(still, 10.0, 0.0, 200.0), GRID)[0]
        cov = np.cov(velocity, bias=True)
        np.testing.assert_allclose(found[0, :3], np.diag(cov), rtol=1e-4)
        np.testing.assert_allclose(found[0, 3:], [cov[0, 1], cov[0, 2], cov[1, 2]], atol=1e-4 * cov[0, 0])


class TestOfAFolder:
    def test_what_is_there_is_not_made_again(self, fields, tmp_path, monkeypatch):
        whole = [field["variance"] for field in fields.keep(tmp_path / "whole", range(1, 5))]
        made = []
        make = fields.make

        def stopping(_, seed):
            if seed == 3 and not made:
                made.append("stop")
                raise KeyboardInterrupt
            made.append(seed)
            return make(seed)

        monkeypatch.setattr(Fields, "make", stopping)
        half = tmp_path / "half"
        with pytest.raises(KeyboardInterrupt):
            made.clear() or [*fields.keep(half, range(3, 5))]
        assert list(half.glob("*")) == []
        back = [field["variance"] for field in fields.keep(half, range(1, 5))]
        again = [field["variance"] for field in fields.keep(half, range(1, 5))]
        assert made == ["stop", 1, 2, 3, 4]
        assert sorted(path.name for path in half.iterdir()) == [f"field-000{seed}.npz" for seed in range(1, 5)]
        np.testing.assert_array_equal(back, whole)
        np.testing.assert_array_equal(again, whole)

    @pytest.mark.parametrize(
        ("change", "other"),
        [
            ({"wind_speed": 9.0}, "wind"),
            ({"shear": 0.0}, "wind"),
            ({"durations": (200.0, 50.0)}, "durations"),
            ({"turbulence": "stable-onshore"}, "turbulence"),
            ({"grid": BoxGrid((64, 8, 8), (40.0, 16.0, 17.0))}, "grid"),
            ({"scans": {"six": brs.load_scan("6-beam")}}, "scans"),
        ],
    )
    def test_fields_of_another_study_are_refused(self, fields, first, change, other, tmp_path):
        write(tmp_path / "field-0001.npz", fields.key(1), first)
        with pytest.raises(
            InputError, match=rf"made with another {other}. Delete it to have the field made again"
        ) as e:
            next(dataclasses.replace(fields, **change).keep(tmp_path, range(1, 2)))
        assert "\n" not in str(e.value)

    def test_a_scan_that_looks_elsewhere_is_another(self, fields):
        wider = {**fields.scans, "six": brs.load_scan("6-beam", opening_angle_deg=16.0)}
        assert dataclasses.replace(fields, scans=wider).key(1) != fields.key(1)

    def test_a_field_of_another_seed_is_refused(self, fields, first, tmp_path):
        write(tmp_path / "field-0002.npz", fields.key(1), first)
        with pytest.raises(InputError, match="another seed"):
            next(fields.keep(tmp_path, range(2, 3)))

    def test_damaged_files_are_refused(self, fields, first, tmp_path):
        path = tmp_path / "field-0001.npz"
        write(path, fields.key(1), first)
        good = path.read_bytes()
        step, refused = len(good) // 40, []
        for place in range(0, len(good), step):
            changed = bytearray(good)
            changed[place] ^= 0x41
            path.write_bytes(changed)
            try:
                found = read(path, fields.key(1))
            except InputError as error:
                refused.append(str(error))
            else:  # a byte that says nothing, such as a time stamp of the archive
                np.testing.assert_array_equal(found["variance"], first["variance"])
        words = re.compile(r"Invalid field .*field-0001.npz: it (is damaged|was made with another).*")
        assert len(refused) > 20
        assert all(words.fullmatch(line) for line in refused)
        for length in (0, 10, len(good) // 2, len(good) - 1):
            path.write_bytes(good[:length])
            with pytest.raises(InputError, match="damaged"):
                read(path, fields.key(1))

    def test_what_is_no_field_is_refused(self, fields, tmp_path):
        path = tmp_path / "field-0001.npz"
        for content in (b"no archive", b"\x93NUMPY\x01\x00"):
            path.write_bytes(content)
            with pytest.raises(InputError, match="damaged, or was not written by this study"):
                read(path, fields.key(1))
        np.savez(path, variance=np.ones(3))
        with pytest.raises(InputError, match="was not written by this study"):
            read(path, fields.key(1))


class TestOfTheCommand:
    def test_it_says_how_to_go_on(self, tmp_path, monkeypatch, capsys):
        def stopped(*_):
            raise KeyboardInterrupt

        monkeypatch.setattr(Fields, "make", stopped)
        monkeypatch.setattr(sys, "argv", ["seed_study_boxes.py", str(tmp_path / "boxes"), "--fields", "2"])
        with pytest.raises(SystemExit) as end:
            seed_study_boxes.main()
        assert end.value.code == 130
        words = capsys.readouterr().err.strip()
        assert words == f"Interrupted: finished fields are in {tmp_path / 'boxes'}; the same command goes on."

    def test_it_refuses_another_folder_in_a_line(self, tmp_path, monkeypatch, capsys):
        (tmp_path / "field-0001.npz").write_bytes(b"nothing")
        monkeypatch.setattr(sys, "argv", ["seed_study_boxes.py", str(tmp_path), "--fields", "1"])
        with pytest.raises(SystemExit) as end:
            seed_study_boxes.main()
        assert end.value.code == 2
        assert capsys.readouterr().err.count("\n") == 1
