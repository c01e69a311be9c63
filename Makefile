# One-word entry points. `make` alone lists them; every target sets up what it needs.

VENV ?= .venv
BIN := $(VENV)/bin
# The Python that makes the environment: set PYTHON to choose, or the first suitable one is taken.
SUITABLE := import ensurepip, sys, venv; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python; do \
    if $$python -c '$(SUITABLE)' 2>/dev/null; then echo $$python; break; fi; done)
# Processes of the test run.
WORKERS ?= 2
RUNS ?= runs
STUDIES := $(patsubst studies/%/study.py,%,$(wildcard studies/*/study.py))
TYPED := $(wildcard pcnav studies benchmarks tests)
LINTED := $(wildcard pcnav studies benchmarks meshes tests docs)
STAMP := $(VENV)/.installed

# Exact versions, also for the build backend that pip runs in an environment of its own (which
# older releases of pip configure by the first variable, newer ones by the second).
export PIP_CONSTRAINT := constraints.txt
export PIP_BUILD_CONSTRAINT := constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# The test processes share the cores, so the linear algebra in each of them stays on one.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
# What the tests of a file share is made once, in the process that runs them all.
PYTEST := $(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

.DEFAULT_GOAL := help
.PHONY: help setup demo docs dist test test-study golden lint format types check bench studies constraints clean distclean

help: ## List the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

setup: $(STAMP) ## Make .venv and install pcnav with everything it is developed with

$(STAMP): pyproject.toml constraints.txt
	@set -eu; python='$(PYTHON)'; \
	if ! $${python:-false} -c '$(SUITABLE)' 2>/dev/null; then \
	    echo "pcnav needs Python 3.11, 3.12 or 3.13 with venv and ensurepip: make setup PYTHON=/path/to/python3" >&2; \
	    exit 1; \
	fi; \
	if $(BIN)/python -m pip --version >/dev/null 2>&1; then \
	    echo "setup 1/2: updating $(VENV), $$($(BIN)/python --version)"; \
	else \
	    echo "setup 1/2: making $(VENV) with $$($$python --version)"; \
	    $$python -m venv --clear $(VENV); \
	fi; \
	echo "setup 2/2: installing up to $$(grep -c '==' constraints.txt) pinned packages (700 MB to download, a minute or more of processor time the first time)"; \
	$(BIN)/python -m pip install --quiet --editable '.[all,dev,docs]'; \
	touch $@; \
	echo "setup done: $(BIN)/pcnav --help"

demo: setup ## Simulate the shipped satellite, navigate, print the table, write the report
	$(BIN)/pcnav demo --overwrite

docs: setup ## Build the documentation site, build/docs/index.html
	$(BIN)/python -m sphinx -E -W --keep-going -q -b html -d build/doctrees docs build/docs
	@echo "docs done: build/docs/index.html"

test: setup ## Run the tests (WORKERS=2 processes)
	$(PYTEST)

test-study: setup ## Run the minutes-long tests that `make test` leaves out
	$(PYTEST) -m study

golden: setup ## Compare every number with the recorded ones (GOLDEN='--only boxsat', or '--update')
	$(BIN)/python -m tests.golden $(GOLDEN)

lint: setup ## Check style and formatting
	$(BIN)/ruff check $(LINTED)
	$(BIN)/ruff format --check $(LINTED)

format: setup ## Apply the formatting and the safe fixes
	$(BIN)/ruff check --fix $(LINTED)
	$(BIN)/ruff format $(LINTED)

types: setup ## Check the types (strict for pcnav)
	$(BIN)/mypy $(TYPED)

check: lint types docs test ## All of lint, types, docs and test

# What a user gets: the core alone, and its answer on a sequence that it makes itself. The sdist is
# unpacked and built, too.
dist: setup ## Build wheel and sdist, and try both in a clean environment
	@set -eu; rm -rf dist; $(BIN)/python -m hatchling build -d dist; \
	folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	for built in dist/*.whl dist/*.tar.gz; do \
	    echo "dist: trying $$built"; \
	    $(BIN)/python -m venv --clear "$$folder/venv"; \
	    "$$folder/venv/bin/python" -m pip install --quiet "$$built"; \
	    (cd "$$folder" && rm -rf runs && venv/bin/pcnav --version && venv/bin/pcnav demo --quiet); \
	done; \
	echo "dist done: $$(ls dist | tr '\n' ' ')"

bench: setup ## Measure pcnav against its peers and its past (BENCH='--only speed --compare')
	$(BIN)/python -m benchmarks $(BENCH)

studies: setup ## Rebuild every study's tables and figures under runs/studies
	@set -e; for study in $(STUDIES); do \
	    echo "study $$study -> $(RUNS)/studies/$$study"; \
	    $(BIN)/pcnav study $$study -o $(RUNS)/studies/$$study; \
	done

# uv resolves once for every Python and system that pyproject.toml admits; it lives in a throw-away
# environment because nothing else needs it.
constraints: ## Resolve constraints.txt anew from pyproject.toml, newest versions
	@set -eu; folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	echo "constraints: resolving for every supported Python and system"; \
	$(PYTHON) -m venv "$$folder/venv"; \
	PIP_CONSTRAINT= "$$folder/venv/bin/python" -m pip install --quiet uv; \
	printf 'hatchling\neditables\n' > "$$folder/build.txt"; \
	"$$folder/venv/bin/uv" pip compile pyproject.toml "$$folder/build.txt" --all-extras \
	    --universal --fork-strategy fewest --python-version 3.11 \
	    --no-annotate --no-header --quiet --output-file "$$folder/pins.txt"; \
	{ echo '# Exact versions of everything pcnav runs on, is tested with, is measured against and is built with,'; \
	  echo '# on every Python and system it supports. Written by `make constraints`; do not edit.'; \
	  cat "$$folder/pins.txt"; } > constraints.txt; \
	echo "constraints: $$(grep -c '==' constraints.txt) versions pinned; run make check"

clean: ## Remove caches and build products
	rm -rf build dist test-report .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean ## As clean, and remove .venv
	rm -rf $(VENV)
