"""The machine around a command: displays, homes, places, terminals, locales, masks and limits of strangers."""

import os
import resource
import shutil
import subprocess
import sys

import numpy as np
import pytest
from fault_scenes import ROOT, complaint
from fit_scene import NOISE, SCAN, make_records
from ray_files import RayTable, windcube_sweep

import bayes_rs as brs
from bayes_rs.cli.group import COMMANDS
from bayes_rs.output import write_netcdf

pytestmark = pytest.mark.slow
OF_RECORDS = ("records.nc", "--scan", "6-beam", "--noise", "noise.nc", "--sampler", "direct", "--ess", "100")
OF_SAMPLES = ("few.csv", "--scan", "6-beam", "--duration", "60")
CASES = {
    "demo": (("demo", "-o", "demo"), "demo/widths.csv"),
    "scans": (("scans", "6-beam", "-o", "scan.png"), "scan.png"),
    "find-scan": (("find-scan", "rays.nc", "--range", "100", "-o", "found.toml"), "found.toml"),
    "look": (("look", "few.csv", "-o", "look.png"), "look.png"),
    "plan": (("plan", "2-beam"), None),
    "records": (("records", *OF_SAMPLES, "-o", "made.nc"), "made.nc"),
    "calibrate": (("calibrate", "2-beam", "--wind-speed", "9.7", "--duration", "60", "-o", "cal.nc"), "cal.nc"),
    "fit": (("fit", *OF_RECORDS, "-o", "again"), "again/run.json"),
    "sensitivity": (("sensitivity", *OF_RECORDS, "--factor", "2", "-o", "table.csv"), "table.csv"),
    "corner": (("corner", "out", "-o", "corner.png"), "corner.png"),
    "report": (("report", "out", "-o", "page.html"), "page.html"),
    "boxes": (("boxes", "out", "--boxes", "1", "--points", "16", "4", "4", "-o", "boxes"), "boxes/boxes.csv"),
    "spectra": (("spectra", *OF_SAMPLES, "-o", "spectra"), "spectra/run.json"),
    "wind": (("wind", *OF_SAMPLES, "-o", "wind.csv"), "wind.csv"),
    "compare": (("compare", "2-beam", "--records", "2", "--duration", "60", "-o", "cmp"), "cmp/comparison.png"),
    "optimize": (("optimize", "--max-angle", "30", "--beams", "3", "--starts", "1", "-o", "best"), "best/run.json"),
}
"""A cheap call of every command, and a file that it writes."""
QUICK = ("scans", "plan", "records")
NOWHERE = "/nonexistent/place"
PLACES = {
    "a backend that is not installed": {"MPLBACKEND": "no-such-backend"},
    "a notebook's backend": {"MPLBACKEND": "module://no_such_package.backend_inline"},
    "no home": {"HOME": None, "MPLCONFIGDIR": None, "BAYES_RS_CACHE": None, "XDG_CACHE_HOME": None},
    "a home that is not there": {"HOME": NOWHERE, "MPLCONFIGDIR": None, "BAYES_RS_CACHE": None, "XDG_CACHE_HOME": None},
    "a cache that is a file": {"BAYES_RS_CACHE": "few.csv", "MPLCONFIGDIR": "few.csv"},
    "no place for temporary files": {"TMPDIR": NOWHERE},
    "a terminal of one column": {"COLUMNS": "1", "LINES": "1"},
    "a terminal of no column": {"COLUMNS": "0", "LINES": "0"},
    "a terminal of abc columns": {"COLUMNS": "abc", "LINES": "-1"},
    "plain C": {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "a locale that is not there": {"LC_ALL": "xx_YY.nonsense", "LANG": "tlh"},
    "ASCII only": {"PYTHONIOENCODING": "ascii"},
    "UTF-16": {"PYTHONIOENCODING": "utf-16"},
}
"""Variables of the environment; None takes one away."""
LIMITS = {
    "a strict mask": lambda: os.umask(0o077),
    "no mask": lambda: os.umask(0),
    "a mask of all": lambda: os.umask(0o777),
    "few open files": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (30, 30)),
    "no stdin": lambda: os.close(0),
    "no streams at all": lambda: os.closerange(0, 3),
}
"""What is done in the process before the command begins."""
TOGETHER = {
    "one": (
        ("a backend that is not installed", "a home that is not there", "a cache that is a file",
         "no place for temporary files", "a terminal of one column", "a locale that is not there", "ASCII only"),
        ("a strict mask", "few open files", "no stdin"),
    ),
    "two": (
        ("a notebook's backend", "no home", "a terminal of abc columns", "plain C"),
        ("no mask", "few open files"),
    ),
}  # fmt: skip
"""Settings that are tried at once: what each spoils can be told from the others."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Samples, records, noise and a fit; all are tiny."""
    folder = tmp_path_factory.mktemp("inputs")
    series = brs.simulate("6-beam", "fu-2022", wind_speed=10.0, n_records=2, duration=60.0, seed=1)
    series.reset_coords()[["time", "beam", "radial_velocity"]].to_dataframe().to_csv(folder / "few.csv", index=False)
    records = make_records(2)
    write_netcdf(records, folder / "records.nc")
    NOISE.save(folder / "noise.nc")
    azimuth = np.tile([0.0, 90.0, 180.0, 270.0], 3)
    rays = RayTable(np.arange(12.0), azimuth, np.full(12, 75.0), np.full((12, 1), 100.0), np.ones((12, 1)))
    windcube_sweep(rays).to_netcdf(folder / "rays.nc", engine="h5netcdf")
    brs.fit(records, SCAN, noise=NOISE, output=folder / "out", sampler="direct", target_ess=100, seed=1)
    return folder


def go(command, inputs, folder, *, places=(), limits=(), before=None, own=None, **streams):
    """Run a command in a copy of the inputs, in a strange place; return its code and what it wrote to stderr."""
    shutil.copytree(inputs, folder)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
        "BAYES_RS_CACHE": str(inputs / "cache"),
        "OPENBLAS_NUM_THREADS": "1",
        "MPLCONFIGDIR": os.environ.get("MPLCONFIGDIR", str(inputs / "matplotlib")),
    }
    for name, value in [item for place in places for item in PLACES[place].items()]:
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    if "BAYES_RS_CACHE" not in environment:
        environment.setdefault("XDG_CACHE_HOME", str(inputs / "cache"))

    def prepare():
        for limit in limits:
            LIMITS[limit]()
        if before is not None:
            before()

    arguments, _ = CASES[command]
    program = ["-m", "bayes_rs"] if own is None else ["-c", own]
    done = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, *program, *arguments],
        cwd=folder,
        env=environment,
        preexec_fn=prepare,
        timeout=500,
        check=False,
        **{"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **streams},
    )
    return done.returncode, done.stdout, (done.stderr or b"").decode("utf-16" if "UTF-16" in places else "utf-8")


def made(command, folder):
    """The file that a command writes, if it writes one."""
    _, name = CASES[command]
    return None if name is None else folder / name


def check(command, inputs, folder, **strange):
    """A command that runs there has the same outcome as anywhere, and says no more than a line for what it misses."""
    code, _, errors = go(command, inputs, folder, **strange)
    assert "Traceback" not in errors, errors
    assert (code, complaint(errors)) == (0, []), errors
    file = made(command, folder)
    assert file is None or file.stat().st_size > 0
    if command == "fit":
        assert (folder / "again" / "summary.csv").read_bytes() == (inputs / "out" / "summary.csv").read_bytes()
    return file


def test_every_command_has_a_case():
    assert CASES.keys() == COMMANDS.keys() - {"app"}  # that one serves until it is interrupted: test_app


@pytest.mark.parametrize("command", [pytest.param(name, marks=[pytest.mark.long] * (name == "demo")) for name in CASES])
def test_a_hostile_place(command, inputs, tmp_path):
    places, limits = TOGETHER["one"]
    file = check(command, inputs, tmp_path / "here", places=places, limits=limits)
    if file is not None:
        assert file.stat().st_mode & 0o077 == 0  # what the mask hides from others stays hidden


@pytest.mark.parametrize("command", QUICK)
def test_another_hostile_place(command, inputs, tmp_path):
    places, limits = TOGETHER["two"]
    check(command, inputs, tmp_path / "here", places=places, limits=limits)


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("command", [name for name in CASES if name != "demo"])
def test_each_place_alone(command, place, inputs, tmp_path):
    check(command, inputs, tmp_path / "here", places=(place,))


@pytest.mark.long
@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("command", [name for name in CASES if name != "demo"])
def test_each_limit_alone(command, limit, inputs, tmp_path):
    check(command, inputs, tmp_path / "here", limits=(limit,))


@pytest.mark.parametrize(
    "command",
    ["records", *(pytest.param(name, marks=pytest.mark.long) for name in CASES if name not in (*QUICK, "demo"))],
)
def test_a_full_disk(command, inputs, tmp_path):
    """One line says it, and nothing half-written takes a name (a folder of a fit may be kept, to be resumed)."""
    own = (
        "import signal, resource; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60, 60)); from bayes_rs.__main__ import main; main()"
    )
    code, _, errors = go(command, inputs, tmp_path / "here", own=own)
    assert "Traceback" not in errors, errors
    assert code == 2, errors
    assert "File too large" in complaint(errors)[0]
    assert not made(command, tmp_path / "here").exists()


@pytest.mark.parametrize("command", ["records", pytest.param("fit", marks=pytest.mark.long)])
def test_a_clock_that_runs_backwards(command, inputs, tmp_path):
    own = (
        "import itertools, time; ticks = itertools.count(); time.time = lambda: 2e9 - 1000.0 * next(ticks); "
        "from bayes_rs.__main__ import main; main()"
    )
    check(command, inputs, tmp_path / "here", own=own)
