# Needs Python >= 3.11 and make, nothing else.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

# Tests and documentation start the program many times: without its bytecode each start would compile it anew.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-all lint docs docs-short accuracy score score-baseline bench bench-all gallery readmes clean

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "crankorder needs Python 3.11 or newer; set PYTHON=…")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

demo: $(STAMP)
	$(BIN)/crankorder demo --out crankorder-demo

test: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist worksteal

test-all: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[notebook]'
	$(BIN)/python -m pytest -n 2 --dist worksteal -m ''

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[docs]'
	$(BIN)/sphinx-build -W --keep-going -q -b html docs docs/_build/html

docs-short: $(STAMP)
	$(BIN)/python docs/executed.py docs/tutorial.md docs/notebook.md docs/howto/*.md

accuracy: $(STAMP)
	$(BIN)/python -m pytest -m accuracy -s

# SCORE='--set 2 --seed 7' repeats a run.
score: $(STAMP)
	$(BIN)/python tests/machines/score.py $(SCORE)

score-baseline: $(STAMP)
	$(BIN)/python tests/machines/score.py --baseline
	$(BIN)/python reports/make_readmes.py

bench: $(STAMP)
	$(BIN)/python benchmarks/campaign.py
	$(BIN)/python reports/make_readmes.py

bench-all: $(STAMP)
	$(BIN)/python benchmarks/campaign.py --all
	$(BIN)/python reports/make_readmes.py

gallery: $(STAMP)
	$(BIN)/python reports/make_gallery.py
	$(BIN)/python reports/make_thesis.py

readmes: $(STAMP)
	$(BIN)/python reports/make_readmes.py

clean:
	rm -rf $(VENV) build dist docs/_build crankorder-demo
