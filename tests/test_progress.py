"""The progress bar."""

import importlib.util
import subprocess
import sys
import types

import pytest
from tqdm import tqdm

from bayes_rs import progress as module
from bayes_rs.progress import progress, progress_counter


def test_silent_where_stderr_is_no_terminal(capfd):
    assert list(progress(range(3), 3, "boxes")) == [0, 1, 2]
    assert capfd.readouterr().err == ""


def test_a_bar_on_request(capfd):
    assert list(progress(iter("ab"), 2, "boxes", disable=False)) == ["a", "b"]
    captured = capfd.readouterr()
    assert "boxes" in captured.err
    assert captured.out == ""


def test_a_program_without_stderr_has_no_progress(monkeypatch):
    """Python sets it to None where a program was started with it closed."""
    monkeypatch.setattr("sys.stderr", None)
    assert list(progress([1, 2], 2, "counting")) == [1, 2]
    with progress_counter(2, "counting", " things") as bar:
        bar.update(2)


class TestNotebook:
    """Its stderr is no terminal, and yet somebody looks at it."""

    @pytest.fixture
    def kernel(self, monkeypatch):
        shell = types.SimpleNamespace(config={"IPKernelApp": {}})
        monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
        monkeypatch.setattr(module, "_PATIENCE", 0.0)

    @pytest.mark.usefixtures("kernel")
    def test_a_bar_of_text_without_ipywidgets(self, capfd, monkeypatch):
        monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
        assert list(progress([1, 2], 2, "counting")) == [1, 2]
        assert "counting:" in capfd.readouterr().err

    @pytest.mark.usefixtures("kernel")
    def test_a_bar_of_widgets_with_it(self, capfd, monkeypatch):
        told = []

        class Bar(tqdm):
            def display(self, *_args, **_options):
                told.append((self.desc, self.n))

        monkeypatch.setattr(importlib.util, "find_spec", lambda _name: object())
        monkeypatch.setattr(module, "notebook_tqdm", lambda: Bar)
        with progress_counter(2, "fitting", " records") as bar:
            bar.update(2)
        assert told[0] == ("fitting", 0)
        assert list(progress([1], 1, "none", disable=True)) == [1]
        assert {what for what, _ in told} == {"fitting"}
        assert capfd.readouterr().err.strip() == ""

    @pytest.mark.usefixtures("kernel")
    def test_what_takes_a_moment_has_none(self, capfd, monkeypatch):
        monkeypatch.setattr(module, "_PATIENCE", 60.0)
        assert list(progress([1, 2], 2, "counting")) == [1, 2]
        assert "counting" not in capfd.readouterr().err

    def test_ipython_in_a_terminal_is_no_notebook(self, capfd, monkeypatch):
        shell = types.SimpleNamespace(config={"TerminalIPythonApp": {}})
        monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
        assert list(progress([1, 2], 2, "counting")) == [1, 2]
        assert capfd.readouterr().err == ""

    @pytest.mark.slow
    def test_in_a_kernel(self):
        """A line that is drawn again, and no warning, which would be an error here."""
        if any(importlib.util.find_spec(name) is None for name in ("nbclient", "nbformat", "ipykernel")):
            pytest.skip("nbclient or ipykernel is not installed: `make check` installs them")
        code = (
            "import time, warnings\nwarnings.simplefilter('error')\nfrom bayes_rs.progress import progress\n"
            "for _ in progress(range(2), 2, 'counting'):\n    time.sleep(0.6)"
        )
        said = subprocess.run(  # noqa: S603 - our own
            [sys.executable, "-c", RUN_NOTEBOOK, code], capture_output=True, text=True, check=True
        ).stdout
        assert "counting: 100%" in said
        assert "Warning" not in said


RUN_NOTEBOOK = (
    "import sys, nbclient, nbformat\nfrom nbformat.v4 import new_code_cell, new_notebook\n"
    "book = new_notebook(cells=[new_code_cell(sys.argv[1])])\n"
    "nbclient.NotebookClient(book, kernel_name='python3', timeout=120).execute()\n"
    "for output in book.cells[0].outputs:\n    print(output.get('text', ''), output.get('data', ''))\n"
)
