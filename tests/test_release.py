"""The version says the same wherever it stands, and an installation holds what a release promises."""

import importlib.metadata
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import bayes_rs
from bayes_rs.models import models_folder

ROOT = Path(__file__).parents[1]
PACKAGE = Path(bayes_rs.__file__).parent


def installed() -> importlib.metadata.Distribution:
    return importlib.metadata.distribution("bayes_rs")


class TestVersion:
    def test_is_that_of_the_installation(self):
        """It differs where the version was changed after `pip install --editable`: install again."""
        assert installed().version == bayes_rs.__version__

    def test_is_that_of_the_citation(self):
        said = re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
        assert said == [bayes_rs.__version__]

    def test_is_written_for_its_date(self):
        """The first release in the changelog is this one, on the citation's day; a development version has none yet."""
        if "dev" in bayes_rs.__version__:
            pytest.skip(f"{bayes_rs.__version__} is no release")
        headings = re.findall(
            r"^## (\d\S*) - (\S+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
        )
        day = re.findall(r"^date-released: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
        assert headings[:1] == [(bayes_rs.__version__, *day)]


class TestMetadata:
    def test_dependencies_are_those_of_the_project_file(self):
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        asked = [plain(line) for line in installed().requires or [] if "extra ==" not in line]
        assert sorted(asked) == sorted(plain(line) for line in project["dependencies"])
        assert installed().metadata["Requires-Python"] == project["requires-python"]

    def test_every_declared_python_can_install_it(self):
        """The oldest Python of the classifiers is the one that `requires-python` asks for."""
        classifiers = installed().metadata.get_all("Classifier")
        minors = [int(found[1]) for line in classifiers if (found := re.fullmatch(r".*:: 3\.(\d+)", line))]
        assert f">=3.{min(minors)}" == installed().metadata["Requires-Python"]

    def test_the_running_python_is_declared(self):
        assert f"Programming Language :: Python :: 3.{sys.version_info.minor}" in installed().metadata.get_all(
            "Classifier"
        )


class TestContent:
    def test_type_information_is_shipped(self):
        assert (PACKAGE / "py.typed").is_file()
        assert (PACKAGE / "__init__.pyi").is_file()

    def test_a_type_checker_sees_the_types(self, tmp_path):
        """mypy, outside of the project, takes a right use and refuses a wrong one."""
        if importlib.util.find_spec("mypy") is None:
            pytest.skip("mypy is not installed: `make check` installs it")
        script = tmp_path / "use.py"
        script.write_text(
            "import bayes_rs as brs\n\nwide: brs.Scan = brs.load_scan('6-beam')\nwrong: int = brs.load_scan('6-beam')\n"
            "up = brs.Scan('up', [[0.0, 0.0, 1.0]], focus_distance=[100.0], beam_time=[0.0], scan_duration=1.0)\n"
            "flow = brs.load_turbulence('fu-2022')\n"
            "one: brs.Noise = brs.noise.calibrate(up, flow, wind_speed=10.0)\n"
            "bank: brs.Noise = brs.noise.calibrate(up, flow, wind_speed=[8.0, 12.0])\n"
            "again: brs.Noise = brs.noise.calibrate(up, flow, wind_speed=10.0, yaw_deg=[0.0, 20.0])\n"
            "brs.plot.corner(brs.open_fit('folder')).savefig('corner.png')\n"
        )
        command = [sys.executable, "-m", "mypy", "--config-file=", "--follow-imports=silent", "use.py"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)  # noqa: S603 - our own
        assert 'use.py:4: error: Incompatible types in assignment (expression has type "Scan"' in done.stdout
        assert done.stdout.count("error:") == 1, done.stdout

    @pytest.mark.parametrize(
        ("kind", "pattern", "least"),
        [
            ("scans", "*.toml", 15),
            ("turbulence", "*.toml", 5),
            ("noise", "*.nc", 15),
            ("demo", "*.parquet", 3),
        ],
    )
    def test_models_are_shipped(self, kind, pattern, least):
        assert len(list(models_folder(kind).glob(pattern))) >= least

    @pytest.mark.parametrize("name", ["template.html", "style.css", "scripts/page.js"])
    def test_the_parts_of_the_report_are_shipped(self, name):
        assert (PACKAGE / "report" / name).is_file()

    def test_no_other_package_comes_along(self):
        """Tests, benchmarks and notebooks stay in the source distribution."""
        tops = {file.parts[0] for file in installed().files or [] if file.suffix == ".py"}
        assert {top for top in tops if not top.startswith("_")} <= {"bayes_rs"}

    def test_the_command_is_the_entry_point(self):
        (entry,) = [entry for entry in installed().entry_points if entry.group == "console_scripts"]
        assert (entry.name, entry.value) == ("bayes-rs", "bayes_rs.__main__:main")
        code = (
            "import importlib.metadata as m; [e] = m.entry_points(group='console_scripts', name='bayes-rs'); e.load()()"
        )
        done = subprocess.run([sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=True)  # noqa: S603 - our own
        assert done.stdout == f"bayes-rs, version {bayes_rs.__version__}\n"

    def test_the_module_runs_as_the_command(self):
        done = subprocess.run(
            [sys.executable, "-m", "bayes_rs", "--version"], capture_output=True, text=True, check=True
        )
        assert done.stdout == f"bayes-rs, version {bayes_rs.__version__}\n"


def plain(requirement: str) -> str:
    """Return a requirement with the order of its bounds and its spaces out of the way."""
    name, bounds = re.match(r"\s*([A-Za-z0-9_.-]+)\s*(.*)", requirement).groups()
    return name.lower().replace("_", "-") + ",".join(sorted(bounds.replace(" ", "").split(",")))
