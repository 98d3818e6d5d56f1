# Two commands on a fresh machine with Python 3.11: `make demo` and `make test`.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: demo suite detector test lint bench format clean

demo: $(VENV)/ready
	$(BIN)/fbench demo

suite: $(VENV)/ready
	$(BIN)/fbench demo --split test -o runs/suite

# Trains the built-in camera detector anew; see docs/detector.md.
detector: $(VENV)/ready
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[torch]'
	$(BIN)/fbench log simulate training -o runs/training
	$(BIN)/fbench weights train runs/training -o runs/city.onnx

test: lint
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

lint: $(VENV)/ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(VENV)/ready
	for file in benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

format: $(VENV)/ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(VENV)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info runs
