# make study   identify the helicopter of examples/uh60; results in out/uh60
# make paper   the paper's comparison on two helicopters, and the chosen last step; in out/paper
# make test    the quick tests, a few minutes
# make slow    the slow tests, an hour and more
# make mutants how many of 400 broken programs the tests notice (hours; may be stopped)
# make docs    the documentation, site/index.html
# make figures the figures and notebooks of the documentation again
# make lint    formatting, rules, types and import layers
# Needs Python 3.11 or newer; everything else goes into .venv, pinned by constraints.txt.

PYTHON ?= python3
VENV ?= .venv
STAMP := $(VENV)/.installed

.PHONY: study paper test slow mutants docs figures lint install clean

study: install
	$(VENV)/bin/casid identify examples/uh60/study.toml

paper: install
	$(VENV)/bin/python examples/paper.py
	$(VENV)/bin/python -m benchmarks.choice --kept out/paper/choice

test: install
	$(VENV)/bin/pytest -n auto --dist worksteal -m "not second and not slow and not campaign"

slow: install
	$(VENV)/bin/pytest -m "second or slow or campaign"

mutants: install
	$(VENV)/bin/python -m benchmarks.mutants

docs: install
	$(VENV)/bin/python -m docs.build

figures: install
	$(VENV)/bin/python -m docs.figures
	$(VENV)/bin/python -m docs.notebooks

lint: install
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "casid needs Python 3.11 or newer: make PYTHON=python3.12"; exit 1; }
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check \
		-c constraints.txt -e ".[dev]"
	touch $(STAMP)

clean:
	rm -rf out build dist site .cache
