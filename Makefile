# make train      sets everything up, trains a policy, evaluates it and shows it: see runs/quickstart
# make test       sets everything up and runs the tests, but for the slow ones: make -f tests/Makefile slow
# make lint       checks style, types and words; make format corrects the style
# make docs       builds the documentation: site/index.html
# make examples   runs the examples that need separate virtual environments, which it creates
# make bench      measures the speed beside other environments, which it installs in .venv-peers, .venv-rware and .venv-jumanji
# make wheel      builds the source archive and the wheel, and tries them outside of this tree
# make clean      removes the virtual environments and what they have written
#
# `make test PYTHON=python3.12` uses another Python, in a virtual environment of its own: .venv-3.12.
#
# What takes minutes to days is in tests/Makefile and experiments/Makefile: `make -f tests/Makefile soak`.

PYTHON ?= python3
VENV := .venv$(if $(filter file,$(origin PYTHON)),,-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])'))
BIN := $(VENV)/bin
OUTSIDE_TESTS := tests/environment/test_env.py tests/wrappers/test_centralized.py tests/instances/test_library.py tests/render

LIBRARIES := rllib benchmarl skrl tianshou xuance
PEER_rware := rware==2.0.0
PEER_jumanji := jumanji==1.1.0 requests

# Python keeps compiled modules even where the environment forbids it: the import of TorchRL takes 3 seconds instead of 8.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: train test lint format docs examples bench wheel clean

train: $(VENV)/installed
	$(BIN)/mapf-pz train quickstart --num-learners auto --output runs/quickstart --overwrite

# By files, so that what the tests of a file share is made once.
test: $(VENV)/developed
	$(BIN)/python -m pytest -n 2 --dist loadfile -m 'not slow'

lint: $(VENV)/developed
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/basedpyright
	$(BIN)/python -m experiments.checks.words

format: $(VENV)/developed
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

docs: $(VENV)/developed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Type checkers and editors find the modules of an editable install only in the mode `compat`.
INSTALL := $(BIN)/pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt \
	--config-settings editable_mode=compat --editable

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) '.[train,render]'
	touch $@

$(VENV)/developed: $(VENV)/installed
	$(INSTALL) '.[train,render,dev]'
	touch $@

bench: $(VENV)/developed .venv-peers/installed .venv-rware/installed .venv-jumanji/installed
	$(BIN)/python -m experiments.speed environments --pogema .venv-peers/bin/python --rware .venv-rware/bin/python --jumanji .venv-jumanji/bin/python

.venv-rware/installed .venv-jumanji/installed: .venv-%/installed:
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/pip install --quiet --disable-pip-version-check $(PEER_$*)
	touch $@

.venv-peers/installed:
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/pip install --quiet --disable-pip-version-check 'pogema==1.4.0' 'pydantic<2'
	touch $@

# With small budgets: these show that the examples run, not what they learn.
examples: $(VENV)/developed .venv-peers/installed $(LIBRARIES:%=.venv-%/installed)
	.venv-rllib/bin/python examples/rllib_ppo.py --iterations 1 --episodes 2
	.venv-benchmarl/bin/python examples/benchmarl_task.py --iterations 1 --output runs/example-benchmarl
	.venv-skrl/bin/python examples/skrl_mappo.py 512
	.venv-tianshou/bin/python examples/tianshou_dqn.py 512
	.venv-xuance/bin/python examples/xuance_ippo.py 4096
	.venv-peers/bin/python examples/in_pogema.py $(BIN)/mapf-pz mappo-cardinal

$(LIBRARIES:%=.venv-%/installed): .venv-%/installed: examples/%-requirements.txt
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/pip install --quiet --disable-pip-version-check --requirement $< --editable .
	touch $@

wheel: $(VENV)/developed
	tests/wheel.sh $(BIN)/python $(OUTSIDE_TESTS)

clean:
	rm -rf .venv .venv-* runs site dist
