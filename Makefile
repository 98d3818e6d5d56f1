# Two commands on a fresh machine with Python 3.11: `make demo` and `make test`. `make test-all` runs the slow tests, too.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt
# Where Python may not keep what it compiles, each of the hundreds of processes of the tests compiles all of fbench.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

# What `make sbom` and `make hashes` run, in an environment of their own.
TOOLS := build/tools
SBOM_TOOLS := cyclonedx-bom==7.5.0 pip-licenses==5.5.5 uv==0.13.9

.PHONY: demo suite detector test test-all fuzz lint bench docs format clean sbom hashes

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

# What `make test` leaves out: slow tests, and those that need torch, which weighs gigabytes, CARLA's client, or Rerun.
test-all: test $(VENV)/ready-torch $(VENV)/ready-carla $(VENV)/ready-rerun
	$(PYTEST) -m "slow or torch"

# Damages and edits all kinds of input; see docs/faults.md.
MINUTES ?= 60
fuzz: $(VENV)/ready-test
	$(BIN)/python -m tests.hostile.run --minutes $(MINUTES)

lint: $(VENV)/ready-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy --num-workers 2

bench: $(VENV)/ready-test
	for file in benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

docs: $(VENV)/ready-docs
	$(BIN)/mkdocs build --quiet --strict

format: $(VENV)/ready-test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Every package of $(VENV), as CycloneDX JSON and as a table of licenses.
sbom: $(VENV)/ready $(TOOLS)/ready
	$(TOOLS)/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible -o build/sbom.json $(BIN)/python
	$(TOOLS)/bin/pip-licenses --python=$(BIN)/python --format=markdown --order=license --output-file=build/licenses.md

# Writes hashes.txt anew, after a change of constraints.txt; without the extra `torch`, whose builds differ.
hashes: $(TOOLS)/ready
	$(TOOLS)/bin/uv pip compile --quiet --generate-hashes --no-header --no-annotate --python-version 3.11.5 \
		--extra test --extra docs -c constraints.txt pyproject.toml -o hashes.txt

# With HASHES=1, `make demo` and `make test` install only files whose SHA-256 is in hashes.txt.
$(VENV)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv --clear $(VENV)
ifdef HASHES
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r hashes.txt
	$(INSTALL) --no-deps --no-build-isolation -e .
else
	$(INSTALL) -e .
endif
	touch $@

$(TOOLS)/ready: Makefile
	$(PYTHON) -m venv --clear $(TOOLS)
	$(TOOLS)/bin/pip install --quiet --disable-pip-version-check $(SBOM_TOOLS)
	touch $@

$(VENV)/ready-%: $(VENV)/ready
	$(INSTALL) -e '.[$*]'
	touch $@

clean:
	rm -rf $(VENV) build dist site *.egg-info runs
