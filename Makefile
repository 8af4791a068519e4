# Needs python3 (3.11+) with venv and pip, and make; everything else goes into .venv.
#   make demo    a 40 % actuator loss on a Panda, controller and rig over CAN, with a report
#   make test    the test suite
#   make help    the rest

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Relative, so that a clone below a folder with a space in its name works: pip splits these at spaces.
export PIP_CONSTRAINT := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

SCENARIO ?= hil/scenarios/panda_shoulder_loss.toml
# e.g. make demo DEMO_ARGS='--set duration_s=8'
DEMO_ARGS ?=
# e.g. make test PYTEST_ARGS='-k bus'
PYTEST_ARGS ?=
# What only computes runs two at a time; what races the clock has the machine to itself.
CHOSEN := not vcan and not benchmark and not slow

.DEFAULT_GOAL := help
.PHONY: help install dev demo test test-vcan lint format benchmark docs examples wheel constraints clean

help: ## List the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

# Two stamps: the demo waits for what it runs on, and not for the linters too.
$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "$(PYTHON) is older than 3.11; name a newer one: make PYTHON=python3.12 …" >&2; exit 3; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) \
	  || { rm -rf $(VENV); echo "no venv module; on Debian: apt-get install python3-venv" >&2; exit 3; }
	$(BIN)/python -m pip install -q -c constraints.txt -e .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]'
	@touch $@

install: $(VENV)/.installed ## Make .venv with what a run needs
dev: $(VENV)/.installed-dev ## ... and with what a developer needs

demo: $(VENV)/.installed ## Run the demo; ends with a summary, names its log and report
	$(BIN)/dftc hil $(SCENARIO) $(DEMO_ARGS)

test: $(VENV)/.installed-dev ## Run the test suite
ifeq ($(strip $(PYTEST_ARGS)),)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -p no:benchmark --durations=10 \
	  -m '$(CHOSEN) and not realtime'
	$(BIN)/python -m pytest --durations=10 -m '$(CHOSEN) and realtime'
else
	$(BIN)/python -m pytest $(PYTEST_ARGS)
endif

test-vcan: $(VENV)/.installed-dev ## Run the tests marked vcan in a User-Mode Linux kernel
	tests/uml/run.sh

lint: $(VENV)/.installed-dev ## ruff, mypy, import-linter
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: $(VENV)/.installed-dev ## Let ruff format and fix what it can
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

benchmark: $(VENV)/.installed-dev ## Measure, each number with its floor from the same run
	$(BIN)/python -m tests.benchmarks $(BENCHMARK_ARGS)

# Both notices are about what may become of MkDocs, and would be taken for warnings about the pages.
docs: $(VENV)/.installed-dev ## Build the documentation as a site, into build/site
	DISABLE_MKDOCS_2_WARNING=true NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

examples: $(VENV)/.installed-dev ## Run every example
	@set -e; for example in examples/*.py; do \
	  test -e "$$example" || { echo "no examples"; break; }; \
	  echo "== $$example"; $(BIN)/python "$$example"; done

wheel: $(VENV)/.installed-dev ## Build the wheel into dist/
	$(BIN)/python -m build --wheel

constraints: ## Renew constraints.txt from what the registry serves today
	rm -rf build/constraints && $(PYTHON) -m venv build/constraints
	env -u PIP_CONSTRAINT -u PIP_BUILD_CONSTRAINT build/constraints/bin/pip install -q \
	  '.[dev,cluster]' editables
	{ sed -n '/^#/p' constraints.txt; \
	  build/constraints/bin/pip freeze --exclude dftc_rt; } > build/constraints.new
	mv build/constraints.new constraints.txt
	rm -rf build/constraints

clean: ## Remove everything that make made
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks \
	  .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
