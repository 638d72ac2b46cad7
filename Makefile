# `make demo` shows what the program does, `make test` guards a change.
# Nothing is assumed but Python 3.11 or newer with pip, make and git.

PYTHON ?= python3
OUT ?= out/demo

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help demo test test-long docs clean

help:
	@echo "make demo       build a few frames and a page to look at, in $(OUT)"
	@echo "make test       run every test that guards a change"
	@echo "make test-long  run the tests that take many minutes"
	@echo "make docs       build the documentation in docs/_build/html"
	@echo "make clean      remove the virtual environment, caches and build products"
	@echo "Another interpreter: make demo PYTHON=python3.12"

demo: $(VENV)/.installed
	$(BIN)/pepperscene build demo --out $(OUT)
	$(BIN)/pepperscene report $(OUT)
	@echo
	@echo "Done. Open $(OUT)/index.html in a browser; the frames lie beside it, one folder per output."

test: $(VENV)/.installed-tests
	$(BIN)/python -m pytest

test-long: $(VENV)/.installed-tests
	$(BIN)/python -m pytest -m long

docs: $(VENV)/.installed-tests
	$(BIN)/python -m sphinx --fail-on-warning --keep-going -b html docs docs/_build/html

clean:
	rm -rf $(VENV) build dist docs/_build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests notebooks -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps say which set of packages the environment holds; a change of pyproject.toml renews them.
$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --editable .
	@touch $@

$(VENV)/.installed-tests: pyproject.toml | $(BIN)/python
	$(PIP) install --quiet --editable '.[test,docs,notebooks]'
	@touch $(VENV)/.installed $@

# An environment that was made only in part is taken away again, lest the next call trust it.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else \
	    "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + "; name another: make demo PYTHON=...")'
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }
