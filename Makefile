# One environment, made once from pyproject.toml's pinned ranges, before any target.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet

.PHONY: demo test test-long lint docs library sanitize mutations ardusub-suite bench clean

$(VENV)/installed: pyproject.toml setup.py $(wildcard autopilot/data/native/*.[ch]) autopilot/core/model4.py autopilot/control/nmpc/model_code.py autopilot/control/energy/interval.py
	@echo "setting up $(VENV) (about a minute)"
	$(PYTHON) -m venv $(VENV)
	$(PIP) --editable '.[analysis]'
	@touch $@

$(VENV)/tools: $(VENV)/installed
	@echo "installing test and lint tools"
	$(PIP) --editable '.[test,lint]'
	@touch $@

$(VENV)/docs: $(VENV)/tools
	@echo "installing the tools of the documentation"
	$(PIP) --editable '.[docs]'
	@touch $@

demo: $(VENV)/installed
	$(BIN)/autopilot demo --out out/demo

test: $(VENV)/tools
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not long"

# Flights of minutes, browsers, clients of others, many processes (tests/conftest.py, LONG).
test-long: $(VENV)/tools
	$(BIN)/python -m pytest -n 2 --dist loadfile -m long

lint: $(VENV)/tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The pages as one site, out/docs/index.html. A broken link or anchor fails.
docs: $(VENV)/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	SITE=out/docs $(BIN)/python -m pytest tests/docs/test_doc_site.py

# Fails, with the reason, where the compiled library cannot be used.
library: $(VENV)/installed
	$(BIN)/python -c "import sys; from autopilot.core.compiled import missing; sys.exit(missing())"

sanitize: $(VENV)/tools
	$(BIN)/python -m tests.sanitize

mutations: $(VENV)/tools
	$(BIN)/python -m tests.mutate --seed 1 --places 200

# With ArduSub's own simulation, built from its sources: make ardusub-suite ARDUSUB=.../build/sitl/bin/ardusub; with
# RECORD=1 its figures are kept and docs/hardware.md is written. Without ARDUSUB: the emulated one, against these figures.
ardusub-suite: $(VENV)/tools
	$(BIN)/python -m tests.bench.ardusub $(if $(ARDUSUB),--ardusub $(ARDUSUB) $(if $(RECORD),--record))
	$(if $(RECORD),$(BIN)/python docs/ardusub_page.py --write)

bench: $(VENV)/installed
	$(BIN)/autopilot bench

clean:
	rm -rf $(VENV) out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
