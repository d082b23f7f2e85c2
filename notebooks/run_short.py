"""Run every notebook in its short form; each ends in a cell that checks one of its numbers.

python notebooks/run_short.py [NAME ...]
"""

import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

FOLDER = Path(__file__).resolve().parent


def main() -> int:
    """Run them, and return how many failed."""
    os.environ["BAYES_RS_SHORT"] = "1"
    os.environ.setdefault("PYTHONWARNINGS", "default")
    names = sys.argv[1:] or sorted(path.name for path in FOLDER.glob("*.ipynb"))
    failed = 0
    for name in names:
        notebook = nbformat.read(FOLDER / name, as_version=4)
        try:
            NotebookClient(notebook, timeout=600, kernel_name="python3").execute(cwd=str(FOLDER))
        except CellExecutionError as error:
            failed += 1
            print(f"{name}: failed\n{error}")
        else:
            print(f"{name}: runs, and its number is right")
    return failed


if __name__ == "__main__":
    sys.exit(main())
