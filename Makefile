# The first Python of this list that is new enough makes .venv; override with `make PYTHON=/path/to/python3 ...`.
PYTHON ?= $(shell for candidate in python3 python3.13 python3.12 python3.11; do \
	if $$candidate -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$candidate; break; fi; done)
BIN := .venv/bin
CORE := .venv/.core
STAMP := .venv/.installed

# Two test processes on two cores; more BLAS threads than that only disturb each other.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# A file's tests stay in one process, so that what a module prepares is prepared once.
PYTEST_ARGS ?= -q -n 2 --dist loadfile
# What .ci/run and .ci/nightly install besides, in the same resolution.
INSTALL_EXTRAS ?=
INSTALL_GROUPS ?= --group dev

.PHONY: demo test test-all realtime emulated nightly soak bench docs notebooks lint release clean install
.DEFAULT_GOAL := install

install: $(STAMP)

# What runs the program; the tools of the tests come on top.
$(CORE): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "error: no Python 3.11 or newer was found; install one, or name it with make PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "error: $(PYTHON) is not a Python 3.11 or newer" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing into .venv (`$(BIN)/python -V`): 0.9 GB, about a minute ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e . -c constraints.txt
	@touch $@

$(STAMP): $(CORE)
	@echo "installing the tools of the tests into .venv: 0.5 GB more, about a minute ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check 'pip>=25.1'
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.$(INSTALL_EXTRAS)' $(INSTALL_GROUPS) -c constraints.txt
	@touch $@

demo: $(CORE)
	@$(BIN)/aerodima demo --out out/demo --force
	@echo 'next: export PATH="$$PWD/$(BIN):$$PATH", then docs/index.md; `aerodima doctor` names what its pages need besides'

# Whether the software is right on this machine.
test: $(STAMP)
	@echo "the fast tests: about four minutes on two quiet cores ..."
	@$(BIN)/python -m pytest $(PYTEST_ARGS) -m "not slow and not realtime and not emulated and not nightly"

# The slow tests and the full draws as well.
test-all: $(STAMP)
	@echo "the fast and the slow tests: about a quarter of an hour on two quiet cores ..."
	@$(BIN)/python -m pytest $(PYTEST_ARGS) -m "not realtime and not emulated"

# One process, nothing beside it; two more tries for what a disturbed machine has made miss its deadline. Each further
# try is printed at the end.
realtime: $(STAMP)
	@$(BIN)/python -m pytest -q -m "realtime and not nightly" --reruns 2

# 2,000 runs on two workers with 1.5 GB each, one of them killed and one stopped on the way.
soak: $(STAMP)
	@echo "2,000 runs: about half an hour on a quiet machine ..."
	@rm -rf out/soak
	@$(BIN)/python -m tests.soak --out out/soak

bench: $(STAMP)
	@echo "measuring: about half an hour on a quiet machine ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e . --group bench -c constraints.txt
	@$(BIN)/python -m tests.benchmarks --out out/bench/bench.csv

# Emulated car, drive, watchdog and browser share the machine here: nothing beside it, and two more tries as above.
emulated: $(STAMP)
	@$(BIN)/python -m pytest -q -m emulated --reruns 2

# Everything, on two Pythons, with notebooks, browsers, firmware and mutants: nothing beside it, an hour and a half.
nightly:
	@echo "everything, on two Pythons: about an hour and a half on a quiet machine ..."
	@bash .ci/nightly

# Strict: a broken link or a reference that cannot be read fails it.
docs: $(STAMP)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e . --group docs -c constraints.txt
	@echo "building the documentation: less than a minute on a quiet machine ..."
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "open out/docs/index.html"

# Executes all notebooks, and stores what they show.
notebooks: $(STAMP)
	@echo "executing all notebooks: some five minutes on a quiet machine ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[notebooks]' -c constraints.txt
	@$(BIN)/python -m tests.notebook_runs

lint: $(STAMP)
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --check --quiet .
	@if $(BIN)/python -c 'from importlib.metadata import version; import sys; sys.exit(tuple(map(int, version("drake").split("."))) < (1, 58))'; \
	then $(BIN)/mypy --no-error-summary; \
	else echo "types not checked: the stubs of this Drake are wrong (see pyproject.toml); .ci/run checks on the newest Python"; fi

# Archives of a release, checked, and the demo of the wheel in an empty environment; the head of .ci/release.py says more.
release:
	@$(PYTHON) .ci/release.py $(if $(VERSION),--version $(VERSION)) $(if $(URL),--url $(URL)) $(RELEASE_ARGS)

clean:
	@rm -rf .venv out dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
