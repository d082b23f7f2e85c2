"""Sizes are known before work starts: what no memory holds, or no one waits for, is refused at once, with numbers."""

import os
import resource
import subprocess
import sys

import numpy as np
import pytest

import bayes_rs as brs
from bayes_rs import InputError, sizes
from bayes_rs.fits import plan as fit_plan
from bayes_rs.fits.fit_options import FitOptions
from bayes_rs.theory.pairs import check_pairs, seconds_of_pairs

GIB = 2.0**30
MOST_CPU_SECONDS = 6.0
"""Of a refusal's whole process: about one second of it loads numpy, scipy and xarray; the rest is a slow machine's."""
MOST_BYTES = 300 * 2**20


class TestChecks:
    def test_memory_is_refused_by_what_is_free(self, monkeypatch):
        monkeypatch.setattr(sizes, "free_memory", lambda: 4.0 * GIB)
        sizes.check_size("Three things", 3.0 * GIB, "take fewer.")
        with pytest.raises(
            InputError, match=r"^Ten things would take 10 GiB of memory, and 4 GiB are free: take fewer\.$"
        ):
            sizes.check_size("Ten things", 10.0 * GIB, "take fewer.")

    def test_work_is_refused_from_a_month_on(self):
        sizes.check_work("A year of records", 20.0 * 86_400.0, "take fewer.")
        for seconds in (1e300, np.inf, np.nan):
            with pytest.raises(InputError, match="of one processor, and more than 30 days is refused: take fewer"):
                sizes.check_work("All records", seconds, "take fewer.")

    def test_the_free_memory_is_that_of_this_process(self):
        free = sizes.free_memory()
        assert 2.0**20 < free < os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") * 1.01

    def test_the_limit_of_a_process_counts(self):
        code = (
            "import resource, bayes_rs.sizes as s; "
            "resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31)); print(s.free_memory() < 2**31)"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603 - our own
        assert done.stdout.strip() == "True"

    def test_a_group_without_limit_has_none(self, tmp_path):
        (tmp_path / "memory.max").write_text("max\n")
        assert sizes._of_group(tmp_path / "memory.max") == np.inf
        (tmp_path / "memory.max").write_text("1000\n")
        (tmp_path / "memory.current").write_text("900\n")
        (tmp_path / "memory.stat").write_text("anon 5\ninactive_file 300\n")
        assert sizes._of_group(tmp_path / "memory.max") == 400.0

    @pytest.mark.parametrize(
        ("n_byte", "words"),
        [(3.0e3, "2.9 KiB"), (5.0 * 2**20, "5 MiB"), (15.0 * GIB, "15 GiB"), (1e22, "9.31e+12 GiB")],
    )
    def test_bytes_in_words(self, n_byte, words):
        assert sizes.in_bytes(n_byte) == words


def test_what_only_posix_has_is_not_needed():
    """Nothing but limits of processes is lost without it."""
    blocked = "import sys; sys.platform = 'win32'; sys.modules['resource'] = None; from bayes_rs import sizes; "
    check = subprocess.run(  # noqa: S603 - our own line
        [sys.executable, "-c", f"{blocked}print(sizes.free_memory() > 0.0)"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (check.stdout, check.stderr) == ("True\n", "")


class TestWork:
    def test_legitimate_scenes_are_within(self):
        """A day of six beams, an hour of four hundred."""
        check_pairs(brs.load_scan("6-beam"), 86_400)
        check_pairs(brs.load_scan("6-beam@n_beams=400"), 3600)
        fit_plan.check_draws(52_560, 6, FitOptions())
        fit_plan.check_draws(6, 6, FitOptions(target_ess=20_000))

    def test_draws_of_years_in_a_folder_are_not_in_memory_together(self, monkeypatch):
        monkeypatch.setattr(sizes, "free_memory", lambda: 8.0 * GIB)
        options = FitOptions(draws="float32")
        fit_plan.check_draws(157_680, 6, options, in_folder=True)
        with pytest.raises(InputError, match=r"^The draws of 157680 records .* would take 43 GiB of memory"):
            fit_plan.check_draws(157_680, 6, options)

    def test_time_grows_with_pairs_lags_and_probes(self):
        six, fifty = brs.load_scan("6-beam"), brs.load_scan("50-beam")
        assert seconds_of_pairs(six, 6000) == pytest.approx(10.0 * seconds_of_pairs(six, 600))
        many = brs.load_scan("spinnerlidar@probe=point")
        assert 10.0 < seconds_of_pairs(many, 300) / seconds_of_pairs(fifty, 300) < 80200 / 1275
        assert seconds_of_pairs(fifty, 6000) < 10.0 * seconds_of_pairs(fifty, 600)  # of many pairs, few lags are needed
        assert seconds_of_pairs(brs.load_scan("zx-tm"), 600) > seconds_of_pairs(fifty, 600)

    def test_a_plan_only_announces_what_takes_long(self):
        made = brs.plan("spinnerlidar-planes", wind_speed=10.0)
        step = made.steps[0]
        assert made.noise is None
        assert step.decision.startswith("by theory, about ")
        assert step.decision.endswith("of one processor for each state of the wind: not computed here")
        assert "2001000 pairs of beams with " in step.why
        assert "weight of a record" not in {step.what for step in made.steps}

    @pytest.mark.parametrize(
        "call",
        [
            lambda: brs.plan("6-beam@n_beams=9999", wind_speed=10.0),
            lambda: brs.compare("6-beam", n_records=10**8),
            lambda: brs.compare("6-beam", n_records=10**8, method="full"),
            lambda: brs.optimize_scan(5000, max_angle_deg=30.0),
            lambda: brs.optimize_scan(5000, max_angle_deg=30.0, criterion="trace"),
            lambda: brs.optimize_scan(6, max_angle_deg=30.0, n_starts=10**6),
            lambda: brs.optimize_scan(6, max_angle_deg=30.0, scan_duration=1e-9),
            lambda: brs.noise.theory("6-beam@n_beams=9999", wind_speed=10.0),
            lambda: brs.noise.theory("2-beam", wind_speed=10.0, duration=1e9),
            lambda: brs.simulate("2-beam", "fu-2022", wind_speed=10.0, n_records=10**9, seed=1),
            lambda: fit_plan.check_draws(10**6, 6, FitOptions(target_ess=100_000, draws="float64")),
            lambda: brs.priors.WeakPrior().draw(10**9, 1),
        ],
    )
    def test_what_cannot_end_is_refused_at_once(self, call, monkeypatch):
        monkeypatch.setattr(sizes, "free_memory", lambda: 8.0 * GIB)  # also on a large machine
        before = resource.getrusage(resource.RUSAGE_SELF)
        with pytest.raises(InputError, match=r"would take|it must be") as raised:
            call()
        after = resource.getrusage(resource.RUSAGE_SELF)
        assert "\n" not in str(raised.value)
        assert after.ru_utime - before.ru_utime < 2.0
        assert after.ru_maxrss - before.ru_maxrss < 100_000  # kB


REFUSED = [
    "plan 2-beam --duration 1e9",
    "plan 2-beam --duration 5e7",
    "plan 6-beam@n_beams=9999",
    "fit none.csv --scan 6-beam --ess 10000000 -o out",
    "fit none.csv --scan 6-beam --seed 1180591620717411303424 -o out",
    "optimize --beams 5000 --max-angle 30 -o out",
    "optimize --beams 6 --max-angle 30 --dwell 1e9 -o out",
    "optimize --beams 6 --max-angle 30 --scan-duration 1e-300 -o out",
    "compare 6-beam --records 100000000 -o out",
    "records none.csv --scan 6-beam --duration 1e-3 -o out.nc",
    "records none.csv --scan 6-beam --time-format %n -o out.nc",
    "spectra none.csv --scan 6-beam --instrument-noise 1e300 -o out",
    "calibrate 6-beam@n_beams=9999 --wind-speed 10 -o out.nc",
]


@pytest.mark.parametrize("words", REFUSED)
def test_a_refusal_costs_little(words, tmp_path):
    """The whole process: what it takes of the processor, and its largest memory."""
    code = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run(sys.argv[1:], capture_output=True, text=True)\n"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(done.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss)\n"
        "print(done.stderr)\n"
    )
    command = [sys.executable, "-c", code, sys.executable, "-m", "bayes_rs", *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)  # noqa: S603 - our own
    numbers, told = done.stdout.split("\n", 1)
    exit_code, seconds, kilobytes = (float(number) for number in numbers.split())
    assert exit_code == 2
    assert len(told.strip().splitlines()) == 1
    assert told.startswith("bayes-rs: ")
    assert "Traceback" not in told
    assert seconds < MOST_CPU_SECONDS
    assert 1024 * kilobytes < MOST_BYTES
