"""What a program loads before its first result: nothing that it does not use. Modules are counted here, not seconds."""

import os
import subprocess
import sys

import pytest

import bayes_rs as brs

SCIPY = {
    f"scipy.{part}"
    for part in [
        "special",
        "linalg",
        "fft",
        "interpolate",
        "spatial",
        "sparse",
        "optimize",
        "stats",
        "ndimage",
        "integrate",
        "signal",
    ]
}
PICTURES = {"matplotlib"}
FIT = {
    "emcee",
    "loky",
    "bayes_rs.fits.batch",
    "bayes_rs.fits.fit_writing",
    "bayes_rs.likelihoods",
    "bayes_rs.theory",
    "bayes_rs.posteriors.posterior",
    "bayes_rs.campaign",
    "bayes_rs.spectra",
    "bayes_rs.noise",
}
"""What a fit is made of."""
NEVER = {"arviz", "numba", "scipy.signal"}
"""What no command uses."""
TABLES = {"pandas", "xarray", "pyarrow", "h5netcdf"}
LATER = SCIPY - {"scipy.special", "scipy.fft"}
"""What the modules of a fit leave for their first numbers."""


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A folder with a file and a fit of it, and the modules that were there after the fit."""
    folder = tmp_path_factory.mktemp("start")
    series = brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=2, seed=1)
    table = series.to_dataframe().reset_index(drop=True)[["time", "beam", "radial_velocity"]]
    table.to_csv(folder / "day.csv", index=False, date_format="%Y-%m-%dT%H:%M:%S.%f")
    return folder, loaded("command(*'fit day.csv --scan 2-beam -o OUT --ess 100'.split())", folder)


@pytest.fixture(scope="module")
def scene(fitted):
    """The folder alone."""
    return fitted[0]


def loaded(code, folder=None):
    """Return the modules that are there after a piece of code in a new process."""
    program = (
        "import sys\n"
        "def command(*words):\n"
        "    from bayes_rs.cli import main\n"
        "    sys.argv = ['bayes-rs', *words]\n"
        "    try: main()\n"
        "    except SystemExit as end: assert not end.code, end.code\n"
        f"{code}\n"
        "print('\\n' + ' '.join(sys.modules))"
    )
    done = subprocess.run(  # noqa: S603 - our own
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "MPLBACKEND": "agg"},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    ("code", "not_there"),
    [
        ("import bayes_rs", {"numpy", "pydantic", *TABLES, *SCIPY, *PICTURES, *FIT, *NEVER}),
        ("import bayes_rs as brs; brs.load_scan('6-beam')", {*TABLES, *SCIPY, *PICTURES, *FIT, *NEVER}),
        ("import bayes_rs as brs; brs.read", {*SCIPY, *PICTURES, *FIT - {"loky"}, *NEVER}),
        ("import bayes_rs as brs; brs.make_records", {*SCIPY, *PICTURES, *FIT, *NEVER}),
        ("import bayes_rs as brs; brs.load_turbulence('fu-2022')", {*TABLES, *LATER, *PICTURES, *FIT, *NEVER}),
        ("import bayes_rs as brs; brs.fit", {"emcee", *LATER, *PICTURES, *NEVER}),
        ("import bayes_rs as brs; brs.open_fit", {"h5netcdf", *SCIPY, *PICTURES, *FIT, *NEVER}),
        ("import bayes_rs as brs; brs.write_report", {"h5netcdf", *SCIPY, *PICTURES, *FIT, *NEVER}),
    ],
    ids=lambda value: value.rsplit(maxsplit=1)[-1] if isinstance(value, str) else "",
)
def test_of_the_package(code, not_there):
    assert loaded(code) & not_there == set()


@pytest.mark.parametrize(
    ("words", "not_there"),
    [
        ("--help", {"numpy", "pydantic", *TABLES, *SCIPY, *PICTURES, *FIT, *NEVER}),
        ("fit --help", {*TABLES, *SCIPY, *PICTURES, *FIT, *NEVER}),
        ("scans", {*TABLES, *SCIPY, *PICTURES, *FIT, *NEVER}),
        ("scans zx-tm", {*TABLES, *SCIPY, *PICTURES, *FIT, *NEVER}),
    ],
)
def test_of_commands_without_files(words, not_there, scene):
    assert loaded(f"command(*{words!r}.split())", scene) & not_there == set()


@pytest.mark.parametrize(
    ("words", "not_there"),
    [
        ("look day.csv", {*PICTURES, *FIT, *NEVER}),
        (
            "records day.csv --scan 2-beam -o made.nc --overwrite",
            {*PICTURES, *FIT - {"loky", "bayes_rs.theory"}, *NEVER, "scipy.stats"},
        ),
        ("corner OUT -o corner.png --overwrite", {*FIT, *NEVER, "scipy.stats", "scipy.interpolate"}),
        ("report OUT -o report.html --overwrite", {*PICTURES, *FIT, *NEVER, "scipy.stats", "scipy.interpolate"}),
    ],
)
def test_of_commands_of_files(words, not_there, scene):
    """SciPy itself may be there: what xarray finds installed loads some of it."""
    assert loaded(f"command(*{words!r}.split())", scene) & not_there == set()


def test_of_a_fit(fitted):
    assert fitted[1] & NEVER == set()


def test_what_is_looked_for_is_there_where_it_is_used(fitted):
    """The names above are those of modules, so that one that is never loaded is not so by its spelling."""
    assert {"emcee", "loky", "scipy.stats", "matplotlib", *TABLES, *FIT} <= fitted[1]
    found = loaded("import arviz, scipy.signal; import bayes_rs as brs; brs.plot.corner")
    assert {"arviz", "scipy.signal"} <= found


def test_a_command_sets_garbage_aside(scene):
    """What modules are made of is not looked through at every 700 new objects, and not at the end."""
    code = (
        "import gc, runpy\n"
        "sys.argv = ['bayes-rs', '--help']\n"
        "try: runpy.run_module('bayes_rs', run_name='__main__')\n"
        "except SystemExit: pass\n"
        "assert gc.isenabled() and gc.get_threshold()[0] == 100_000, gc.get_threshold()"
    )
    loaded(code, scene)
