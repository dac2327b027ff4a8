# Everything needs only python3 (3.11 or newer) and make. Nothing is installed outside .venv, and nothing twice: the
# stamps inside .venv are older than pyproject.toml only when the dependencies may have changed.

PYTHON ?= python3
SCENARIO ?= dense-ped
NAVIGATOR ?= densecavoid
SEED ?= 7
OUT ?= runs/demo
PYTEST_ARGS ?=
EPISODES ?= 500
RESULTS ?= runs/results

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
BASE_STAMP := $(VENV)/.installed-base
TEST_STAMP := $(VENV)/.installed-test
DEV_STAMP := $(VENV)/.installed-dev

# Threads that wait for work sleep, so that OpenMP, numba and torch do not fight for the cores of a laptop.
export OMP_WAIT_POLICY := passive

.DEFAULT_GOAL := help
.PHONY: help setup demo test quick lint benchmark table clean distclean

help: ## list the commands
	@awk -F ': .*## ' '/^[a-z]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

setup: $(BASE_STAMP) ## make .venv and install the base package (no torch)

demo: $(BASE_STAMP) ## set up, then one robot in one crowd: SCENARIO, NAVIGATOR, SEED, OUT
	$(BIN)/densecavoid run --scenario $(SCENARIO) --navigator $(NAVIGATOR) --seed $(SEED) --out $(OUT)

test: $(TEST_STAMP) ## set up with torch, then all tests: PYTEST_ARGS
	$(BIN)/python -m pytest $(PYTEST_ARGS)

quick: $(TEST_STAMP) ## the tests without the slow ones
	$(BIN)/python -m pytest -m "not slow" $(PYTEST_ARGS)

lint: $(DEV_STAMP) ## ruff and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

benchmark: $(BASE_STAMP) ## speed of the simulator, printed
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script" || exit 1; done

table: $(BASE_STAMP) ## the README's results: every navigator in every test, into RESULTS (EPISODES a cell); goes on where it stopped
	$(BIN)/densecavoid benchmark --episodes $(EPISODES) --out $(RESULTS) \
		--navigators densecavoid frozone dwa social-force orca orca-privileged go-to-goal oracle

clean: ## remove caches and build outputs (runs/ and .venv stay)
	rm -rf build dist .pytest_cache .ruff_cache .hypothesis
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print | xargs rm -rf

distclean: clean ## remove .venv too
	rm -rf $(VENV)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit(f"needs Python 3.11 or newer, $(PYTHON) is {sys.version.split()[0]}: make PYTHON=/path/to/python3.11")'
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "$(PYTHON) -m venv failed: on Debian and Ubuntu, install python3-venv" >&2; exit 1; }

$(BASE_STAMP): pyproject.toml | $(BIN)/python
	$(PIP) install --editable .
	@touch $@

# torch by itself and first: the resolver then has the one large package settled, and the rest cannot move its version.
$(TEST_STAMP): $(BASE_STAMP)
	$(PIP) install torch==2.13.0
	$(PIP) install --editable ".[train,test]"
	@touch $@

$(DEV_STAMP): $(TEST_STAMP)
	$(PIP) install --editable ".[train,test,dev]"
	@touch $@
