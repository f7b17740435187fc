# Each target builds .venv first; nothing else needs doing on a fresh machine with Python ≥ 3.11.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
WORKERS ?= 2
# How long each measurement of `make realtime` lasts, and how long `make soak` tries damaged files [s].
REALTIME ?= 60
SOAK ?= 600

.PHONY: demo test lint format bench realtime soak clean

demo: $(INSTALLED)
	$(BIN)/dynid demo --out demo --force

test: $(INSTALLED)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(INSTALLED)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# figaroh, mcap, pymoo and pyswarms are peers to measure against, never dependencies of dynid.
bench: $(INSTALLED)
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[bench]'
	$(BIN)/python -m benchmarks

# What depends on how busy the computer is: measured, never tested.
realtime: $(INSTALLED)
	$(BIN)/python -m benchmarks.realtime $(REALTIME)

# Damaged files against the commands, hostile streams against the drivers: what is found becomes a test in tests/found.
soak: $(INSTALLED)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/soak $(SOAK)

clean:
	rm -rf $(VENV) demo build *.egg-info

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "dynid needs Python 3.11 or newer; call make PYTHON=/path/to/python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]'
	@touch $@
