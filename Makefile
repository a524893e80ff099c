# Every target does its own set-up: `make demo` and `make test` work on a fresh machine with Python 3.11 or newer.
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.ready
TESTS  := $(VENV)/.ready-dev
# The first Python on the path that is new enough; `make PYTHON=...` overrides it.
FITS   := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(firstword $(foreach name,python3 python3.14 python3.13 python3.12 python3.11 python,\
            $(shell $(name) -c '$(FITS)' 2>/dev/null && echo $(name))))

# On all cores, file by file in the order of tests/conftest.py.
BY_FILE := --numprocesses=auto --dist=loadfile --no-loadscope-reorder

# What the tests need beside the core and the group `dev` of pyproject.toml.
EXTRAS := calibrate ros sklearn studio

# One BLAS thread: the arrays are small and batched; threads are used where they pay (tag detection).
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# Many tests start processes: their modules are compiled once.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all bench docs picture lock clean

help:
	@echo "make demo      learn the bundled recording and validate it on another one"
	@echo "make test      lint, types of the package, layers and tests"
	@echo "make test-all  the slow tests and all types as well, and how much of the code the tests run"
	@echo "make bench     accuracy and speed, written to out/benchmarks/"
	@echo "make docs      write the generated parts of docs/cli.md and docs/recording.md anew, and the commands' options"
	@echo "make picture   draw the pictures of the README, of docs/first-beam.md and docs/studio.md again"
	@echo "make lock      renew the locked dependencies"
	@echo "make clean     remove the environment and everything made"

demo: $(STAMP)
	$(BIN)/onebend learn examples/linear-beam/train --output out/linear-beam --validate examples/linear-beam/fast --force

# The types of the package are checked beside the tests. `make test-all` checks those of tests and benchmarks as well,
# which nearly doubles the time that the types take.
test: $(TESTS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@$(BIN)/mypy src & types=$$!; $(BIN)/pytest $(BY_FILE); tests=$$?; wait $$types && exit $$tests

test-all: $(TESTS)
	$(BIN)/mypy
	$(BIN)/pytest $(BY_FILE) -m "" --cov=onebend --cov-report=term:skip-covered --cov-fail-under=90

bench: $(TESTS)
	$(BIN)/python -m benchmarks

docs: $(TESTS)
	$(BIN)/python -m benchmarks.pages

picture: $(TESTS)
	$(BIN)/python examples/readme_picture.py
	$(BIN)/python examples/first_beam_pictures.py
	$(BIN)/python examples/studio_pictures.py

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "onebend needs Python 3.11 or newer, and none was found. Install one, or name it: make $(MAKECMDGOALS) PYTHON=/path/to/python"; exit 1; }
	@$(PYTHON) -c '$(FITS)' || { echo "onebend needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1 | head -n 1)."; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "$(PYTHON) cannot make virtual environments. On Debian or Ubuntu: apt install python3-venv"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }

# A lock is whole: pip installs what it names and resolves nothing, so that newer versions on the index change nothing.
# `pip check` then finds what a lock may lack.
INSTALL := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-deps
CHECK   := $(BIN)/python -m pip --disable-pip-version-check check

$(STAMP): $(VENV)/bin/python requirements.lock pyproject.toml
	$(INSTALL) --require-hashes -r requirements.lock
	$(INSTALL) --no-build-isolation --editable .
	$(CHECK)
	@touch $@

$(TESTS): $(STAMP) requirements-dev.lock
	$(INSTALL) --require-hashes -r requirements-dev.lock
	$(CHECK)
	@touch $@

# Locks carry hashes and no host names. uv is needed only here. docs/contributing.md says how to prove a new lock.
lock: $(STAMP)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	    pyproject.toml tools/build.in -o requirements.lock
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-header \
	    pyproject.toml tools/build.in --group dev $(addprefix --extra ,$(EXTRAS)) -c requirements.lock -o requirements-dev.lock

clean:
	rm -rf $(VENV) out build dist
