# Each target builds .venv first; nothing else needs doing on a fresh machine with Python ≥ 3.11.
PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
# One more than processors: some tests wait for a browser or by the computer's clock.
WORKERS ?= 3
# How long each measurement of `make realtime` lasts, and how long `make soak` tries [s].
REALTIME ?= 60
SOAK ?= 600

.PHONY: demo test coverage lint format bench realtime soak studies-check house docs docs-check wheel sbom clean

demo: $(INSTALLED)
	$(BIN)/dynid demo --out demo --force

# Property tests draw the same examples in every run; `make soak` draws new ones. Bytecode is kept: without it, collection
# takes twice as long.
test: $(INSTALLED)
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --hypothesis-profile=ci -n $(WORKERS) --dist worksteal

# Which lines and branches no test runs, in the terminal and as pages; what runs in a process of its own does not count.
coverage: $(INSTALLED)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --hypothesis-profile=ci -n $(WORKERS) --dist worksteal \
		--cov --cov-report=term --cov-report=html:build/coverage

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
	$(BIN)/python -m benchmarks.recording.realtime $(REALTIME)

# Damaged files against the commands, then the property tests with many random examples: a file that is found becomes a
# case of tests/found, an example that is found an @example of its test.
soak: $(INSTALLED)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/soak $(SOAK)

# Minutes: commands of the docs that meet a running arm, on simulated ones (DOCS: words of commands).
docs-check: $(INSTALLED)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/support/docs_check.py $(DOCS)

# Hours: the commands of docs/measurements again, and which figures no longer agree (STUDIES: words of pages or commands).
studies-check: $(INSTALLED)
	$(BIN)/python studies/check.py $(STUDIES)

# Rooms and arrows, from the imports.
house: $(INSTALLED)
	$(BIN)/python -m studies.house

# The site in build/site; opens from the disk, fetches nothing. --strict: a lost link or anchor ends it.
docs: $(INSTALLED)
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

# Wheel and sdist in dist/, checked as a user meets them: the wheel alone in a fresh environment runs the demo.
wheel: $(INSTALLED)
	rm -rf dist build/wheel
	$(BIN)/python -m pip install -q -c constraints.txt build
	$(BIN)/python -m build --outdir dist
	$(PYTHON) -m venv build/wheel
	build/wheel/bin/pip install -q -c constraints.txt dist/*.whl
	cd build/wheel && bin/dynid demo --out demo --force

# What is installed, with versions and licences, as CycloneDX: from the environment alone, without a network.
sbom: $(INSTALLED)
	$(BIN)/python -m studies.sbom > build/sbom.json

clean:
	rm -rf $(VENV) demo build *.egg-info

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "dynid needs Python 3.11 or newer; call make PYTHON=/path/to/python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]'
	@touch $@
