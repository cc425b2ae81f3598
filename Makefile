# One environment, made once from pyproject.toml's pinned ranges, before any target.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet

.PHONY: demo test lint bench clean

$(VENV)/installed: pyproject.toml setup.py $(wildcard autopilot/data/native/*.[ch])
	@echo "setting up $(VENV) (about a minute)"
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable .
	@touch $@

$(VENV)/tools: $(VENV)/installed
	@echo "installing test and lint tools"
	$(PIP) --editable '.[test,lint]'
	@touch $@

demo: $(VENV)/installed
	$(BIN)/autopilot demo --out out/demo

test: $(VENV)/tools
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(VENV)/tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/installed
	$(BIN)/autopilot bench

clean:
	rm -rf $(VENV) out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
