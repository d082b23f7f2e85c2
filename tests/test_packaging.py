"""What takes the package elsewhere says what the project says: conda's recipe, the Dockerfile, the paper's draft."""

import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

import bayes_rs

ROOT = Path(__file__).parents[1]
CONDA_NAMES = {"matplotlib": "matplotlib-base"}
"""Names of packages at conda-forge that differ: without the toolkits of windows, which nothing here needs."""


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def project():
    return tomllib.loads(text("pyproject.toml"))


@pytest.fixture(scope="module")
def recipe():
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed: distributed, of the tests' packages, brings it")
    return yaml.safe_load(text("packaging/conda/recipe.yaml"))


@pytest.fixture(scope="module")
def steps():
    lines = [line for line in text("Dockerfile").splitlines() if line and not line.startswith("#")]
    return [line.split(maxsplit=1) for line in lines]


def split(requirement):
    """Name and bounds, in one spelling."""
    name, bounds = re.fullmatch(r"([A-Za-z0-9_.-]+?)\s*([<>=!~].*)?", requirement).groups()
    return name, ",".join(sorted((bounds or "").replace(" ", "").split(",")))


class TestConda:
    def test_run_needs_what_the_project_needs(self, recipe, project):
        asked = dict(map(split, project["project"]["dependencies"]))
        wanted = {CONDA_NAMES.get(name, name): bounds for name, bounds in asked.items()}
        assert dict(map(split, recipe["requirements"]["run"])) == {
            **wanted,
            "python": project["project"]["requires-python"],
        }

    def test_host_builds_it(self, recipe, project):
        (backend,) = project["build-system"]["requires"]
        assert dict(map(split, recipe["requirements"]["host"])) == {
            **dict([split(backend)]),
            "pip": "",
            "python": project["project"]["requires-python"],
        }

    def test_it_is_this_version_of_this_package(self, recipe, project):
        assert recipe["schema_version"] == 1
        assert recipe["context"]["version"] == bayes_rs.__version__
        about = project["project"]
        assert recipe["package"]["name"] == about["name"]
        assert recipe["about"]["summary"] == about["description"]
        assert recipe["about"]["license"] == about["license"]
        assert [recipe["about"]["license_file"]] == about["license-files"]
        (entry,) = recipe["build"]["python"]["entry_points"]
        assert entry.split(" = ") == list(*about["scripts"].items())

    def test_its_source_is_the_project(self, recipe):
        assert (ROOT / "packaging" / "conda" / recipe["source"]["path"]).resolve() == ROOT.resolve()


class TestDocker:
    def copied(self, steps):
        return [source for word, rest in steps if word == "COPY" for source in rest.split()[:-1]]

    def test_what_is_copied_is_there_and_is_sent(self, steps):
        sent = [line[1:] for line in text(".dockerignore").splitlines() if line.startswith("!")]
        for source in self.copied(steps):
            assert (ROOT / source).exists()
            assert any(fnmatch(source, pattern) for pattern in sent)

    def test_what_the_build_needs_is_copied(self, steps, project):
        include = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
        needed = {
            "pyproject.toml",
            "bayes_rs",
            project["project"]["readme"],
            *project["project"]["license-files"],
            *include,
        }
        assert set(self.copied(steps)) == needed

    def test_it_does_what_the_readme_says(self, steps):
        """`make demo`, in its own words, after `pip install .`."""
        words = dict(steps)
        command = f"{words['ENTRYPOINT']} {words['CMD']}"
        demo = re.search(r"^demo:.*\n\t.*/(bayes-rs demo .*)$", text("Makefile"), re.MULTILINE)[1]
        assert " ".join(re.findall(r'"([^"]+)"', command)) == demo
        assert "make demo " in text("README.md")
        assert any(word == "RUN" and rest.startswith("pip install --no-cache-dir . ") for word, rest in steps)
        assert "\npip install . " in text("README.md")
        assert "\ndocker build -t bayes-rs . && docker run --rm bayes-rs " in text("README.md")

    def test_it_runs_on_a_declared_python_and_as_a_user(self, steps, project):
        words = [word for word, _ in steps]
        python = re.fullmatch(r"python:(3\.\d+)-slim", dict(steps)["FROM"])[1]
        assert f"Programming Language :: Python :: {python}" in project["project"]["classifiers"]
        assert dict(steps)["USER"] == "user"
        assert words.index("USER") < words.index("ENTRYPOINT")


class TestPaper:
    def test_every_citation_has_an_entry_and_every_entry_is_cited(self):
        cited = set(re.findall(r"@([A-Z]\w+)", text("paper/paper.md")))
        assert cited == set(re.findall(r"^@article\{(\w+),", text("paper/paper.bib"), re.MULTILINE))

    def test_sources_are_those_of_the_documentation(self):
        """No number of a volume, page or DOI that is not in docs/citing.md or CITATION.cff."""
        known = text("docs/citing.md") + text("CITATION.cff")
        for field in ("doi", "volume", "year"):
            for value in re.findall(rf"^  {field} = \{{(.+)\}}", text("paper/paper.bib"), re.MULTILINE):
                assert value in known

    def test_title_and_authors_are_those_of_the_citation(self):
        citation = text("CITATION.cff")
        title = re.search(r'^title: "(.*)"', citation, re.MULTILINE)[1]
        (author,) = re.findall(r'^  - name: "(.*)"', citation, re.MULTILINE)
        paper = text("paper/paper.md")
        assert f'title: "{title}"' in paper
        assert re.findall(r"^  - name: (.*)$", paper, re.MULTILINE)[0] == author

    def test_the_tools_are_those_that_were_compared(self):
        rows = re.findall(r"^\| ([^|]+) \|.*\|$", text("paper/paper.md"), re.MULTILINE)
        compared = text("docs/other-tools.md")
        for tool in rows[2:]:
            for name in re.split(r" / | with ", tool.strip("` ")):
                assert name in compared

    def test_its_measured_numbers_are_those_of_the_readme(self):
        numbers = "0.160 (0.155 to 0.165) where"
        for name in ("paper/paper.md", "README.md"):
            assert numbers in " ".join(re.sub(r"\s+", " ", text(name)).split()).replace("0.160\n", "0.160 ")
            assert "0.162" in text(name)


def test_the_source_distribution_has_all_of_it(project):
    shipped = project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert {"paper", "packaging", "Dockerfile", ".dockerignore"} <= set(shipped)
