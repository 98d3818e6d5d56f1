# Two commands on a fresh machine with Python 3.11: `make demo` and `make test`. `make test-all` runs the slow tests, too.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt
PYTEST := $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: demo suite detector test test-all fuzz lint bench docs format clean

demo: $(VENV)/ready
	$(BIN)/fbench demo

suite: $(VENV)/ready
	$(BIN)/fbench demo --split test -o runs/suite

# Trains the built-in camera detector anew; see docs/detector.md.
detector: $(VENV)/ready
	$(INSTALL) -e '.[torch]'
	$(BIN)/fbench log simulate training -o runs/training
	$(BIN)/fbench weights train runs/training -o runs/city.onnx

test: lint
	$(PYTEST) -m "not slow"

# What `make test` leaves out: slow tests, and those that need torch, which weighs gigabytes.
test-all: test $(VENV)/ready-torch
	$(PYTEST) -m "slow or torch"

# Damages and edits all kinds of input; see docs/faults.md.
MINUTES ?= 60
fuzz: $(VENV)/ready-test
	$(BIN)/python -m tests.hostile.run --minutes $(MINUTES)

lint: $(VENV)/ready-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(VENV)/ready-test
	for file in benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

docs: $(VENV)/ready-docs
	$(BIN)/mkdocs build --quiet --strict

format: $(VENV)/ready-test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(VENV)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(VENV)
	$(INSTALL) -e .
	touch $@

$(VENV)/ready-%: $(VENV)/ready
	$(INSTALL) -e '.[$*]'
	touch $@

clean:
	rm -rf $(VENV) build dist site *.egg-info runs
