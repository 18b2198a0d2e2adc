# `make demo` and `make test` need nothing but Debian, make, git and Python 3.11; both set up .venv by themselves, once.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
# The demonstration starts processes that would compile our modules anew where bytecode may not be kept.
unexport PYTHONDONTWRITEBYTECODE
STAMP := $(VENV)/.installed
REWRITTEN := $(VENV)/.rewritten

.PHONY: setup demo test checks check lint types contracts unit counterparts mutants fuzz durations docs lock bench bench-tests deb \
	deb-test clean

setup: $(STAMP)

$(STAMP): requirements-dev.lock pyproject.toml
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v >= (3, 11) else f"decanter needs Python 3.11 or newer, found {v[0]}.{v[1]}: set PYTHON=/path/to/python3.11")'
	@$(PYTHON) -c 'import venv, ensurepip' || { echo "This Python has no venv module: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@$(MAKE) --no-print-directory -j 2 $(VENV)/.half0 $(VENV)/.half1
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@sync  # now, and not half a minute later under tests that wait for the disk
	@touch $@

# Every other package of the lock, so that two pips unpack side by side; the lock is whole, nothing has to be resolved.
# Nothing is compiled that nothing loads: what the tests load is compiled by their collection, while mypy runs.
$(VENV)/.half%: requirements-dev.lock
	@awk -v half=$* '/^[^ ]/ { number++ } number % 2 == half' $< > $@.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes -r $@.lock
	@touch $@

demo: $(STAMP)
	$(BIN)/decanter demo

# mypy takes one core for most of a minute where it has no cache yet: here it has what the tests leave idle while they
# wait for time to pass. Whoever wants to know of types first runs `make check`.
test: $(STAMP)
	@$(MAKE) --no-print-directory -j 2 --output-sync lint contracts $(REWRITTEN)
	@$(MAKE) --no-print-directory -j 2 types unit BEFORE_MYPY="nice -n 19"

checks: $(STAMP)
	@$(MAKE) --no-print-directory -j 2 --output-sync lint types contracts $(REWRITTEN)

# pytest compiles every test file anew, with its assertions rewritten, when it first meets it, and Python every library:
# once here instead of in each of their processes at the same time. What changes later is compiled by them.
$(REWRITTEN): $(STAMP)
	@$(BIN)/pytest --collect-only -q > $(VENV)/collected.txt || { cat $(VENV)/collected.txt; exit 1; }
	@touch $@

# The inner loop: everything that neither starts a process nor takes long (tests/durations.json).
check: checks
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder --without-processes

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BEFORE_MYPY) $(BIN)/mypy

contracts: $(STAMP)
	$(BIN)/lint-imports

# A file's tests stay in one process, so that what they share is made once. One process more than cores: many tests wait
# for time to pass. A fourth, of low priority, computes while they all do.
unit: $(STAMP)
	$(BIN)/pytest -n 4 --dist loadfile --no-loadscope-reorder --spare

# Servers and programs that tests ask for, as far as Debian has them; root's. Without them those tests are skipped, and
# `make test` says in its end which and how to get them.
counterparts:
	@.ci/counterparts

# Bugs put in one by one where a wrong number would be believed ([tool.mutmut.tests] in pyproject.toml lists the modules),
# and whether a test fails with each: the share, and those with which none does. ONLY=codec for some modules, SAMPLE=60
# for so many bugs of each, drawn at random (SEED, 0). It fails under nine of ten.
mutants: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --editable '.[mutants]'
	nice -n 10 $(BIN)/python -m tests.mutants --sample $(or $(SAMPLE),0) --seed $(or $(SEED),0) $(ONLY)

# Every parser and protocol side, INPUTS each (100000); TARGET=name for one, SEED for others, JOBS targets at a time. It
# goes on where it stopped (out/fuzz). Its short form is a test.
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz.campaign

# What tests/conftest.py orders files by, and leaves out of `make check`: measured on a machine with nothing else to do.
durations: $(STAMP)
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder --write-durations
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder --write-durations --without-processes

# docs/ as a searchable site in out/site; a dead link or a page that the navigation lacks is an error.
docs: $(STAMP)
	$(BIN)/mkdocs build --strict

# The locks are made anew by hand, when a dependency is raised on purpose.
lock: $(STAMP)
	$(BIN)/uv pip compile pyproject.toml --extra dev --generate-hashes --python-version 3.11 --no-emit-index-url --no-header -q --upgrade -o requirements-dev.lock
	$(BIN)/uv pip compile pyproject.toml --extra mqtt --extra opcua --extra postgres --extra prometheus --generate-hashes --python-version 3.11 --no-emit-index-url --no-header -c requirements-dev.lock -q -o requirements.lock
	echo pyarrow | $(BIN)/uv pip compile - --generate-hashes --python-version 3.11 --no-emit-index-url --no-header -c requirements-dev.lock -q -o requirements-parquet.lock

# The Debian package with an environment of its own, and the one with Arrow for it, in dist/ (docs/operations.md).
deb: $(STAMP)
	$(BIN)/python deploy/build_deb.py

# That package in a small Debian of its own, under a real systemd; root's, and the first time with Debian's packages.
deb-test: $(STAMP)
	$(BIN)/python -m benchmarks.installed

# Whether each benchmark still runs, in a tiny setting; `make test` only loads them.
bench-tests: $(STAMP)
	$(BIN)/pytest -m benchmark tests/benchmarks

bench: $(STAMP)
	$(BIN)/python -m benchmarks.run

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build dist out
