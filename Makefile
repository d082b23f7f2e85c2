# Two commands do everything on a machine with python3 (3.11 or later) and make:
#   make demo    runs the main job on embedded data
#   make test    passes the tests
# Set-up happens by itself, in .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# byte code is kept, also where the environment says otherwise: each process of the tests would compile the package anew
ENV := PYTHONNOUSERSITE=1 PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

SECONDS ?= 3600
SEED ?= 1
INPUTS ?= 1500

.PHONY: demo test test-long test-durations stress fuzz check docs benchmarks data noise clean

demo: $(VENV)/installed
	$(ENV) $(BIN)/bayes-rs demo --overwrite

test: $(VENV)/installed-test
	$(ENV) $(BIN)/python -m pytest -n 2 --dist loadfile $(PYTEST_OPTIONS)

test-long: $(VENV)/installed-test
	$(ENV) $(BIN)/python -m pytest -n 2 -m long $(PYTEST_OPTIONS)

# every test that takes a second or more, slowest first
test-durations: $(VENV)/installed-test
	$(ENV) $(BIN)/python -m pytest -n 2 --dist loadfile --durations=0 --durations-min=1 -q \
		| grep -E '^[0-9.]+s (call|setup|teardown) ' > tests/durations.txt

# random cases against references and laws, for as long as told
stress: $(VENV)/installed-test
	$(ENV) $(BIN)/python tests/stress/long_run.py --seconds $(SECONDS)

# hostile files, options and calls, each in a process of its own, as many of each family as told
fuzz: $(VENV)/installed-test
	$(ENV) $(BIN)/python tests/fuzz/long_run.py --seed $(SEED) --inputs $(INPUTS)

check: $(VENV)/installed-check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(ENV) $(BIN)/python -m pytest --doctest-modules --doctest-glob='*.md' -p no:cacheprovider --ignore=docs/conf.py --ignore=docs/_build --ignore=docs/api --ignore=docs/benchmarks --ignore=docs/notebooks bayes_rs README.md docs
	$(BIN)/nbstripout --verify notebooks/*.ipynb

# the site, in docs/_build/html, all notebooks run in their short form: a warning, or one that fails, is an error; no network
docs: $(VENV)/installed-docs
	$(ENV) $(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html

# the benchmarks page, benchmarks/measured.md: about half an hour on two quiet cores
benchmarks: $(VENV)/installed-test
	$(ENV) $(BIN)/python benchmarks/page.py

# what is shipped in models/, made again; `noise` takes about half an hour
data: $(VENV)/installed-test
	$(BIN)/python benchmarks/make_demo_data.py
noise: $(VENV)/installed-test
	$(BIN)/python benchmarks/calibrate_shipped_noise.py
	$(BIN)/python benchmarks/make_noise_nets.py

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(PIP) "pip>=25.1"

$(VENV)/installed: pyproject.toml bayes_rs/_version.py | $(VENV)/bin/python
	$(PIP) --editable .
	touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(PIP) --editable ".[app,boxes]" --group test
	touch $@

$(VENV)/installed-check: $(VENV)/installed-test
	$(PIP) --group check
	touch $@

$(VENV)/installed-docs: $(VENV)/installed-test
	$(PIP) --group docs
	touch $@

clean:
	rm -rf $(VENV) bayes-rs-demo dist build docs/_build docs/api docs/benchmarks docs/notebooks
