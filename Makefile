# Every target sets up .venv by itself; python3 (3.11 or newer) and make are all it needs.
PYTHON ?= python3
PYTHONS ?= python3.11 python3.12 python3.13
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.setup-stamp
BENCH_STAMP := $(VENV)/.bench-stamp
WEB_STAMP := $(VENV)/.web-stamp
# Byte code is made of what is imported, when it is: of everything it would take half a minute.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt

# `make setup EXTRAS=dev,browser` installs for all targets at once.
EXTRAS ?= dev

# Two test processes, each single-threaded: small networks get slower on two threads.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false
WORKERS ?= 2
WEB_WORKERS ?= 2
ARGS ?=
# Leaves out what tests/slow.txt names; `make test QUICK=` runs it.
QUICK ?= -m "not slow"

SECTION := yizhuang RJ WYJ --time 101

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-all test-web wheel-check serve check lint types layers docs bench constraints api client words clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(STAMP)  ## make .venv with everything development needs

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "error: metropilot needs Python 3.11 or newer, but '$(PYTHON)' is" \
		"$$($(PYTHON) --version 2>/dev/null || echo missing); choose another: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || { \
		echo "error: '$(PYTHON) -m venv' failed; on Debian and Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	@echo "setup: installing into $(VENV) (once; a minute or two)"
	@$(PIP) --editable '.[$(EXTRAS)]'
	@touch $@ $(if $(findstring browser,$(EXTRAS)),$(WEB_STAMP))

$(BENCH_STAMP): $(STAMP)
	@$(PIP) --editable '.[dev,nlp]'
	@touch $@

$(WEB_STAMP): $(STAMP)
	@$(PIP) --editable '.[dev,browser]'
	@touch $@

demo: $(STAMP)  ## drive a real section near the energy optimum and draw it
	$(BIN)/metropilot drive $(SECTION) --driver optimal --out demo/drive
	$(BIN)/metropilot compare $(SECTION) --drivers optimal,manual,flat_out --out demo/compare
	@echo "The picture of the drive: demo/drive/profile.png; the comparison: demo/compare/"

test: $(STAMP)  ## run the tests but those of tests/slow.txt (ARGS="-k protection" is passed to pytest)
	$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --ignore tests/browser $(QUICK) $(ARGS)

test-web: $(WEB_STAMP)  ## click through the console in headless Chromium (says so where there is none)
	$(BIN)/python -m pytest tests/browser -n $(WEB_WORKERS) --dist worksteal $(QUICK) $(ARGS)

test-all:  ## run all tests of both, for a release (half an hour on two cores)
	$(MAKE) test test-web QUICK=

wheel-check: $(STAMP)  ## build the wheel, install it into an empty environment, drive with it from elsewhere
	$(BIN)/python tools/wheel_check.py $(ARGS)

serve: $(STAMP)  ## open the console at http://127.0.0.1:8060
	$(BIN)/metropilot serve

check: lint types layers docs  ## lint, format, types, layers, documentation

lint: $(STAMP)  ## ruff: rules and format
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(WEB_STAMP)  ## pyright (of the tests in a browser, too)
	$(BIN)/basedpyright --pythonpath $(BIN)/python

layers: $(STAMP)  ## imports only point left
	$(BIN)/lint-imports --no-cache --no-logo

docs: $(STAMP)  ## build the documentation strictly into site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

bench: $(BENCH_STAMP)  ## run the benchmarks (adds the extra nlp to .venv)
	$(BIN)/python -m benchmarks

constraints:  ## resolve constraints.txt anew under each of PYTHONS
	$(PYTHON) tools/constraints.py $(PYTHONS)

api: $(STAMP)  ## write docs/api.md anew from the packages' public doors
	$(BIN)/python tools/api_page.py

client: $(STAMP)  ## write the typed client of the HTTP API in examples/client anew
	$(BIN)/python tools/http_client.py

words: $(STAMP)  ## gather the texts of the console into its catalogue, and compile it
	$(BIN)/python tools/words.py

clean:  ## remove what the targets made, .venv included
	rm -rf $(VENV) site demo build dist .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
