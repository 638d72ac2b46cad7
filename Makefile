# `make demo` shows what the program does, `make check` and `make test` guard a change.
# Needs only Python 3.11 or newer with pip, make and git.

PYTHON ?= python3
OUT ?= out/demo
# Test processes at a time; each needs about 2 GB of memory.
JOBS ?= 2
# Threads of each test process: more than there are cores for all processes only slow each other down.
THREADS ?= 1
# The tests that need PyTorch run with a CPU build of it; they are skipped where none can be installed.
TORCH ?= --index-url https://download.pytorch.org/whl/cpu --retries 0 --timeout 15 torch

# A file of exact versions for pip: `make test CONSTRAINTS=requirements/lock.txt VENV=.venv-lock`.
CONSTRAINTS ?=

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
INSTALL := $(PIP) install --quiet $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS))
LIMITS := $(foreach name,PEPPERSCENE OIDN_NUM OMP_NUM OPENBLAS_NUM,$(name)_THREADS=$(THREADS)) PEPPERSCENE_PROCESSES=1
# Byte code is kept even where the environment prevents it: tests start hundreds of processes.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(LIMITS) $(BIN)/python -m pytest --numprocesses=$(JOBS) --dist=loadscope

.DEFAULT_GOAL := help
.PHONY: help demo check test test-long durations lock docs clean

help:
	@echo "make demo       build a few frames and an HTML report in $(OUT)"
	@echo "make check      lint, types, import layers and unit tests (under two minutes)"
	@echo "make test       everything that guards a change"
	@echo "make test-long  tests that take minutes or guard what rarely changes, and many more examples of properties"
	@echo "make durations  the seconds of each test in the last whole run"
	@echo "make lock       write the versions of the installed packages to requirements/lock.txt"
	@echo "make docs       build the documentation in docs/_build/html"
	@echo "make clean      remove the virtual environment, caches and build products"
	@echo "Use another interpreter: make demo PYTHON=python3.12"

demo: $(VENV)/.installed
	$(BIN)/pepperscene build demo --out $(OUT)
	$(BIN)/pepperscene report $(OUT)
	@echo
	@echo "Done. Open $(OUT)/index.html in a browser; the images are in $(OUT), one folder per output."

check: $(VENV)/.installed-tests
	$(PYTEST) -m 'not slow and not long' tests
	$(PYTEST) tests/project/test_style.py tests/project/test_packages.py

# SINCE=main also runs the examples of the pages that changed since that revision.
test: $(VENV)/.installed-tests
	PEPPERSCENE_SINCE=$(SINCE) $(PYTEST)

# First what takes minutes; then the other tests that draw examples, with many of them.
test-long: $(VENV)/.installed-docs
	$(PYTEST) -m long --timeout=0 --hypothesis-profile=long
	$(PYTEST) -m 'not long and hypothesis' --hypothesis-profile=long

durations:
	@cat out/durations.txt

# PyTorch has other versions on other machines, so it is left out.
lock: $(VENV)/.installed-docs
	@mkdir -p requirements
	{ printf '# What the tests passed with, on Linux with Python 3.11; written by `make lock`.\n'; \
	  $(PIP) freeze --exclude-editable --exclude torch; } > requirements/lock.txt

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx --fail-on-warning --keep-going -b html -d docs/_build/doctrees docs docs/_build/html

clean:
	rm -rf $(VENV) build dist docs/_build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests notebooks -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp files record which packages are installed; a change of pyproject.toml renews them.
$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(INSTALL) --editable .
	@touch $@

# PyTorch comes first: as a dependency of another package pip would install a build with gigabytes of CUDA.
# Byte code is compiled for the modules that the tests import, and not for all: half of the time to install.
$(VENV)/.installed-tests: pyproject.toml | $(BIN)/python
	@$(BIN)/python -c 'import torch' 2>/dev/null || $(PIP) install --quiet --no-compile $(TORCH) \
	    || echo "No CPU build of PyTorch can be installed; the tests that need it are skipped."
	@extras=test; $(BIN)/python -c 'import torch' 2>/dev/null && extras=$$extras,test-learn; \
	    echo $(INSTALL) --no-compile --editable ".[$$extras]"; \
	    $(INSTALL) --no-compile --editable ".[$$extras]"
	@touch $(VENV)/.installed $@

$(VENV)/.installed-docs: $(VENV)/.installed-tests
	$(INSTALL) --editable ".[docs,notebooks]"
	@touch $@

# An incomplete environment is removed, so that the next call does not use it.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else \
	    "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + "; name another: make demo PYTHON=...")'
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }
