"""The check of the prior from the command line, and what a fit says of the direction that its scan sees least."""

import sys

import numpy as np
import pandas as pd
import pytest
from scenes import draw_variances, plain_noise, records_of

from bayes_rs import STRESSES, cli, load_scan, prior_sensitivity
from bayes_rs import fit as run_fit
from bayes_rs.fits.prior_check import COLUMNS, sensitivity_lines
from bayes_rs.priors.ratio import WeakPrior

FACTORS = ("--factor", "0.5", "--factor", "3")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Records of a staring lidar and their noise, in memory and in files."""
    folder = tmp_path_factory.mktemp("sensitivity")
    scan = load_scan("staring")
    noise, rng = plain_noise(scan), np.random.default_rng(3)
    records = records_of(draw_variances(WeakPrior().draw(3, rng), scan, noise, rng), scan)
    records.to_netcdf(folder / "records.nc", engine="h5netcdf")
    noise.save(folder / "noise.nc")
    return folder, records, scan, noise


@pytest.fixture
def run(monkeypatch, capsys, scene):
    """Run the command on the scene's records; return exit code, lines of stdout and of stderr."""
    folder = scene[0]

    def command(*more):
        words = ["sensitivity", folder / "records.nc", "--scan", "staring", "--noise", folder / "noise.nc", *more]
        monkeypatch.setattr(sys, "argv", ["bayes-rs", *map(str, words)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return caught.value.code or 0, out.splitlines(), err.splitlines()

    return command


def test_the_file_holds_the_table_of_the_function(run, scene, tmp_path):
    _, records, scan, noise = scene
    code, _, err = run(*FACTORS, "--seed", 7, "--prob", 0.8, "-o", tmp_path / "check.csv")
    assert code == 0
    assert err == ["instrument noise: the records do not tell it, and none is taken off their variances"]
    expected = prior_sensitivity(records, scan, noise=noise, seed=7, factors=(0.5, 3.0), prob=0.8)
    written = pd.read_csv(tmp_path / "check.csv")
    assert tuple(written.columns) == COLUMNS
    pd.testing.assert_frame_equal(written, expected, check_exact=False, rtol=1e-12)


def test_every_option_reaches_the_function(run, tmp_path):
    """Each option alone changes the table: none is read and forgotten."""
    changes = [
        ("--prior", "flat:bound=20"),
        ("--factor", 1.5),
        ("--prob", 0.5),
        ("--target", "ensemble"),
        ("--sampler", "direct"),
        ("--instrument-noise", 0.1),
        ("--yaw-sd", 8.0),
        ("--seed", 9),
    ]
    tables = []
    for index, change in enumerate([(), *changes]):
        path = tmp_path / f"{index}.csv"
        assert run(*change, "-o", path)[0] == 0
        tables.append(path.read_bytes())
    assert len(set(tables)) == len(tables)


def test_what_is_printed_is_in_the_table(run, scene):
    _, records, scan, noise = scene
    code, out, _ = run(*FACTORS)
    assert code == 0
    assert "90 % interval, equal-tailed" in out[0]
    assert "3 records" in out[0]
    assert out[2].split()[:3] == ["stress", "prior", "posterior"]
    table = prior_sensitivity(records, scan, noise=noise, seed=1, factors=(0.5, 3.0))
    plain = table[table["factor"] == 1.0].set_index("stress")
    for line, name in zip(out[3:], STRESSES, strict=True):
        words = line.split(maxsplit=6)
        assert words[0] == name
        numbers = [plain.loc[name, "prior_width"], plain.loc[name, "width"]]
        of_stress = table[table["stress"] == name].set_index("factor")["width_ratio"]
        numbers += [of_stress[0.5], of_stress[3.0], plain.loc[name, "decided"]]
        np.testing.assert_allclose([float(word) for word in words[1:6]], numbers, atol=0.0051)  # two decimals
        assert words[6] == plain.loc[name, "decided_by"]
    assert out[3].endswith("the data")  # uu: what a staring lidar sees
    assert out[5].endswith("the prior")  # ww: what it cannot


def test_lines_without_another_factor():
    table = pd.DataFrame([(1.0, "uu", 4.0, 1.0, 1.0, 0.0, 0.9, "")], columns=list(COLUMNS))
    assert sensitivity_lines(table)[0].split() == ["stress", "prior", "posterior", "decided", "by"]
    assert sensitivity_lines(table)[1].split() == ["uu", "4.00", "1.00", "0.90"]


def test_noise_is_made_where_no_file_is_given(scene):
    _, records, scan, _ = scene
    said = []
    table = prior_sensitivity(records, scan, seed=1, say=said.append)
    assert len(table) == 3 * len(STRESSES)
    assert len(said) == 3  # the length scale, which records of variances do not tell, the noise, and the instrument's
    assert "fu-2022" in said[1]
    assert "do not tell it" in said[2]


def test_refusals_come_before_the_work(run, tmp_path):
    path = tmp_path / "there.csv"
    path.write_text("mine")
    code, out, err = run("-o", path)
    assert (code, out) == (2, [])
    assert len(err) == 1
    assert "exists" in err[0]
    assert path.read_text() == "mine"
    code, out, err = run("--factor", "-1")
    assert (code, out) == (2, [])
    assert "Invalid factor -1" in err[-1]


def words_of_fit(records, scan, noise, folder):
    """The last of what a fit of these records says, and its result."""
    result = run_fit(records, scan, seed=1, noise=noise, sampler="direct", campaign="off", output=folder / "out")
    return result.words[-1], result


class TestLeastSeenDirection:
    @pytest.mark.parametrize(
        ("name", "which"),
        [
            ("6-beam", "the beams hardly see "),
            (
                "50-beam",
                "the beams do not see vv and ww together (− 0.05 uu + 0.71 vv + 0.71 ww): ",
            ),  # the null direction of 15°
            ("staring", "the beams do not see (one of 5 such directions) "),
        ],
    )
    def test_it_is_named_with_what_the_prior_says(self, name, which, tmp_path):
        scan = load_scan(name)
        noise, rng = plain_noise(scan), np.random.default_rng(4)
        records = records_of(draw_variances(WeakPrior().draw(3, rng), scan, noise, rng), scan)
        line, result = words_of_fit(records, scan, noise, tmp_path)
        assert line.startswith(which)
        table = result.directions()
        middle = table[table["weight"] == table["weight"].min()].groupby("direction").median(numeric_only=True)
        least = middle.sort_values("contraction_shape").iloc[0]
        said = line.rsplit(": ", 1)[1]
        assert said.endswith(" % of its share of the whole comes from the prior")
        wanted = 100.0 * min(max(1.0 - least["contraction_shape"], 0.0), 1.0)
        assert float(said.split()[0]) == pytest.approx(wanted, abs=0.51)  # whole per cents are written

    def test_a_record_that_was_not_fitted_does_not_count(self, tmp_path):
        scan = load_scan("6-beam")
        noise, rng = plain_noise(scan), np.random.default_rng(4)
        records = records_of(draw_variances(WeakPrior().draw(3, rng), scan, noise, rng), scan)
        records["flag"][1] = 1
        line, result = words_of_fit(records, scan, noise, tmp_path)
        assert np.isnan(result.directions()["contraction"]).sum() == 6
        assert "nan" not in line

    def test_nothing_is_said_where_nothing_was_fitted(self, tmp_path):
        scan = load_scan("6-beam")
        records = records_of(np.ones((2, 6)), scan)
        records["flag"][:] = 1
        line, _ = words_of_fit(records, scan, plain_noise(scan), tmp_path)
        assert line.startswith("prior ")
