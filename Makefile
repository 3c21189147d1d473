# Every target makes .venv and installs what it needs first: `make demo` works on a bare clone.

PYTHON ?= python3
OUT    ?= build/demo
BENCH  ?= build/benchmarks.json
JOBS   ?= auto
ARGS   ?=

SHELL := bash
.DEFAULT_GOAL := help
.NOTPARALLEL:
.DELETE_ON_ERROR:

# Golden tests and those on recorded data compute for long: they run as XLA optimises for users.
FAST := 'not slow and not data and not golden'

# What `make test` installs, and what an editable install builds with.
EXTRAS  := all,dev
BACKEND := hatchling editables

BIN    := .venv/bin
PYTEST := $(BIN)/pytest -n $(JOBS) --maxprocesses=8 --dist=worksteal

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
# Checked and rewritten modules take seconds to compile: once for all test processes and steps.
export PYTHONDONTWRITEBYTECODE :=
# The build backend is pinned too; older pips read the first name, newer ones the second.
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_BUILD_CONSTRAINT := $(CURDIR)/constraints.txt

.PHONY: help
help: ## this list
	@sed -nE 's/^([a-z-]+):.*## (.*)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 22

.PHONY: demo
demo: .venv/.studio ## the main job, end to end, on a recorded log: OUT=build/demo, ARGS='--until 60'
	$(BIN)/kedge demo --out $(OUT) $(ARGS)

.PHONY: test
test: .venv/.dev ## the fast tests: ARGS='tests/filters -k extended'
	$(PYTEST) -m $(FAST) $(ARGS)

# What is run a second time with XLA in the place of machine code, which `auto` prefers; filters
# that draw or iterate are XLA's in either case.
ENGINES := tests/contracts/test_filters.py tests/estimation tests/studies \
  -k 'not (auxiliary or guided or particle or ensemble or enkf or etkf or hermite or posterior)'

.PHONY: slow
slow: .venv/.dev ## the slow tests, those of the other engine, those on recorded data (KEDGE_DATA)
	$(PYTEST) -m 'slow and not data and not golden' $(ARGS)
	KEDGE_ENGINE=xla $(PYTEST) -m $(FAST) $(ENGINES)
	XLA_FLAGS= $(PYTEST) -m 'data or golden' $(ARGS)

.PHONY: slow-list
slow-list: .venv/.dev ## which of the fast tests take too long to be called fast: tests/slow.txt
	$(PYTEST) -m $(FAST) --list-slow $(ARGS)

.PHONY: lint
lint: .venv/.dev ## format, lint, types, layers
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/lint-imports --no-logo --cache-dir build/import-linter

.PHONY: check
check: lint test ## all that a change must pass: lint, then the fast tests

.PHONY: docs
docs: .venv/.docs ## the documentation's site, without a warning: build/site/index.html
	$(BIN)/sphinx-build -W --keep-going -q -d build/doctrees docs build/site

.PHONY: bench
bench: .venv/.dev .venv/.rivals ## the benchmarks, alone on the machine: BENCH=build/benchmarks.json
	BENCH=$(BENCH) $(BIN)/pytest benchmarks $(ARGS)

.PHONY: honesty
honesty: .venv/.dev ## every recorded run below KEDGE_DATA: RMSE, coverage, NEES: ARGS='hanyang --until 60'
	$(BIN)/python examples/honesty.py $(ARGS)

.PHONY: fuzz
fuzz: .venv/.dev ## damaged input to every reader: ARGS='--inputs 20000 --workers 2'
	$(BIN)/python tests/fuzz/fuzz.py $(ARGS)

.PHONY: format
format: .venv/.dev ## rewrite the sources in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.PHONY: constraints
constraints: $(BIN)/python ## pin the newest versions of everything, on the oldest Python supported
	@$(BIN)/python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' \
	  || { echo "constraints.txt is made on Python 3.11: remove .venv, then make constraints PYTHON=python3.11" >&2; exit 1; }
	@mkdir -p build
	@echo "resolving every extra: a minute or two ..."
	@env -u PIP_CONSTRAINT -u PIP_BUILD_CONSTRAINT $(BIN)/python -m pip install --quiet --dry-run \
	  --ignore-installed --report build/resolved.json '.[all,docs,dev]' $(BACKEND) 2>build/pip.log \
	  || { cat build/pip.log >&2; exit 1; }
	@$(BIN)/python -c "$$PIN" <build/resolved.json >build/constraints.txt
	@mv build/constraints.txt constraints.txt
	@echo "constraints.txt: $$(grep -c == constraints.txt) packages"

define PIN
import json, sys
found = [item["metadata"] for item in json.load(sys.stdin)["install"]]
pins = {item["name"].lower().replace("_", "-"): item["version"] for item in found}
print("# Written by 'make constraints'; tested as it stands. Works on Python 3.11 to 3.13.")
print(*(f"{name}=={pins[name]}" for name in sorted(pins) if name != "kedge-nav"), sep="\n")
endef
export PIN

.PHONY: clean
clean: ## remove what was built; .venv stays
	rm -rf build dist .pytest_cache .ruff_cache .hypothesis .import_linter_cache .benchmarks
	find src tests benchmarks examples docs -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "kedge needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." >&2; \
	  echo "Name another one: make PYTHON=python3.12 ..." >&2; exit 1; }
	@echo "creating .venv with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv .venv && $(BIN)/python -m pip --version >/dev/null || { \
	  rm -rf .venv; echo "$(PYTHON) cannot create an environment; on Debian: apt-get install python3-venv" >&2; exit 1; }

# $(call install,EXTRAS): one line for each large download, pip's own words only if it fails.
define install
	@echo "installing kedge-nav[$(1)]: a few minutes when nothing is cached ..."
	@set -o pipefail; $(BIN)/python -m pip install --progress-bar off --constraint constraints.txt \
	  --editable '.[$(1)]' 2>&1 | tee .venv/pip.log \
	  | sed -nE 's/^ *(Downloading|Using cached) ([^ ]*\/)?([^ /]+) (\([0-9.]+ MB\)).*/  \3 \4/p' \
	  || { tail -n 30 .venv/pip.log >&2; echo "pip could not install kedge-nav[$(1)]; it says why above" >&2; exit 1; }
endef

.venv/.studio: pyproject.toml constraints.txt | $(BIN)/python
	$(call install,studio)
	@touch $@

.venv/.dev: pyproject.toml constraints.txt | $(BIN)/python
	$(call install,$(EXTRAS))
	@touch $@ .venv/.studio

.venv/.docs: pyproject.toml constraints.txt | $(BIN)/python
	$(call install,docs)
	@touch $@

.venv/.rivals: pyproject.toml constraints.txt | .venv/.dev
	$(call install,rivals)
	@touch $@
