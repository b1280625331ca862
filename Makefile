# make train   sets everything up, trains a policy, evaluates it and shows it: see runs/quickstart
# make test    sets everything up and runs the tests
# make bench-peers   measures the speed beside POGEMA's, which it installs in .venv-peers
# make lint    checks style and types
# make soak, make faults, make coverage, make record-pogema   see docs/trust.md

PYTHON ?= python3
BIN := .venv/bin
COVERAGE := --cov=mapf_pz --cov=wrappers --cov-branch
KERNEL_TESTS := $(addprefix tests/core/test_, properties.py symmetry.py collision_table.py distance.py)

.PHONY: train test lint format figures reproduction bench-peers soak faults coverage record-pogema clean

train: .venv/installed
	$(BIN)/mapf-pz train quickstart --output runs/quickstart

test: .venv/installed
	$(BIN)/python -m pytest -n 2
	NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest -n 2 $(KERNEL_TESTS)

lint: .venv/installed
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/basedpyright

format: .venv/installed
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

figures: .venv/installed
	$(BIN)/python docs/figures.py

reproduction: .venv/installed
	$(BIN)/python docs/reproduction.py

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[train,render,dev]'
	touch $@

soak: .venv/installed
	$(BIN)/python -m tests.soak

faults: .venv/installed
	$(BIN)/python -m tests.faults

coverage: .venv/installed
	$(BIN)/python -m pytest -n 2 $(COVERAGE) --cov-report=
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -n 2 $(COVERAGE) --cov-append --cov-report=term-missing:skip-covered tests/core tests/planners -k 'not ten_thousand'

record-pogema: .venv-peers/installed
	PYTHONPATH=. .venv-peers/bin/python -m tests.recordings.record_pogema tests/recordings

bench-peers: .venv/installed .venv-peers/installed
	$(BIN)/mapf-pz benchmark --pogema .venv-peers/bin/python

.venv-peers/installed:
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/pip install --quiet --disable-pip-version-check 'pogema==1.4.0' 'pydantic<2'
	touch $@

clean:
	rm -rf .venv .venv-peers runs
