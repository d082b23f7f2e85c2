"""What a program costs before its first result: CPU of a new process, of imports and of commands of one small file.

python benchmarks/start_up.py [--runs 5] [--other TREE]

The file is one simulated hour of six beams (6 records). Medians of the CPU of the process and its children are
printed, with BLAS on one thread; with --other those of another source tree, too, the two in turn. What is loaded by
which command is pinned in tests/test_start.py.
"""

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import bayes_rs as brs

CODE = {
    "import numpy": "import numpy",
    "import xarray": "import xarray",
    "import bayes_rs": "import bayes_rs",
    "brs.load_scan('6-beam')": "import bayes_rs as brs; brs.load_scan('6-beam')",
    "brs.read": "import bayes_rs as brs; brs.read",
    "brs.fit": "import bayes_rs as brs; brs.fit",
    "brs.open_fit('OUT').summary()": "import bayes_rs as brs; brs.open_fit('OUT').summary()",
}
COMMANDS = (
    "--help",
    "fit --help",
    "scans",
    "look hour.csv",
    "records hour.csv --scan 6-beam -o made.nc --overwrite",
    "fit hour.csv --scan 6-beam -o OUT --overwrite --sampler direct",
    "fit hour.csv --scan 6-beam -o OUT --overwrite",
    "corner OUT -o corner.png --overwrite",
    "report OUT -o report.html --overwrite",
)


def cpu(words: list[str], tree: Path, folder: Path) -> float:
    """Return the seconds of CPU of a program and what it starts."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, *words]
    subprocess.run(command, check=True, capture_output=True, env=environment, cwd=folder)  # noqa: S603 - our own
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--other", type=Path, help="the source tree of another version")
    options = parser.parse_args()
    trees = [Path(__file__).parents[1], *([options.other.resolve()] if options.other else [])]
    jobs = {name: ["-c", code] for name, code in CODE.items()}
    jobs |= {f"bayes-rs {words}": ["-m", "bayes_rs", *words.split()] for words in COMMANDS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        series = brs.simulate("6-beam", "fu-2022", wind_speed=10.0, n_records=6, seed=1)
        table = series.to_dataframe().reset_index(drop=True)[["time", "beam", "radial_velocity"]]
        table.to_csv(folder / "hour.csv", index=False, date_format="%Y-%m-%dT%H:%M:%S.%f")
        cpu(["-m", "bayes_rs", *COMMANDS[-3].split()], trees[0], folder)
        for job, words in jobs.items():
            seconds = [[cpu(words, tree, folder) for tree in trees] for _ in range(options.runs)]
            medians = [statistics.median(of_tree) for of_tree in zip(*seconds, strict=True)]
            print("".join(f"{median:8.2f}" for median in medians), job, flush=True)


if __name__ == "__main__":
    main()
