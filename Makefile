# `make repro` runs the pipeline, `make test` the tests, `make bench` the benchmarks. Each sets up .venv first, where it is
# missing.
PYTHON ?= python3
export DVC_NO_ANALYTICS := 1
BIN := .venv/bin

.DEFAULT_GOAL := help
.PHONY: help setup repro test test-fast bench fuzz lint wheel clean

help:  ## show this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 16

setup: .venv/complete  ## install into .venv, and nothing else

.venv/complete: requirements.lock pyproject.toml tools/setup.sh
	@PYTHON="$(PYTHON)" bash tools/setup.sh

repro: .venv/complete  ## run what is out of date, from raw surveys to reports/index.html
	@$(BIN)/python tools/repro.py

test: .venv/complete  ## the tests, with the whole pipeline at smoke scale among them
	@$(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

test-fast: .venv/complete  ## the tests that take no more than a few seconds each
	@$(BIN)/python -m pytest -m 'not slow' --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

bench: .venv/complete  ## loop closures by MAP; registrations against small_gicp and Open3D: medians of 5 runs, about 2 minutes
	@$(BIN)/python benchmarks/pair.py
	@$(BIN)/python benchmarks/gicp.py --open3d --json

fuzz: .venv/complete  ## every reader of raw files on 10,000 damaged ones, twice; some 20 minutes
	@$(BIN)/python -m pip install --quiet -e '.[fuzz]'
	@$(BIN)/python tests/helpers/fuzz.py

lint: .venv/complete  ## ruff, and mypy --strict on src
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

wheel: .venv/complete  ## build dist/*.whl, install it into an empty environment and import it there
	@rm -rf dist build
	@$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	@rm -rf build/wheel && $(BIN)/python -m venv build/wheel
	@build/wheel/bin/python -m pip install --quiet --no-deps --no-index dist/*.whl
	@build/wheel/bin/python -I -c 'import pointnetkl; print("pointnetkl", pointnetkl.__version__)'

clean:  ## remove .venv (data, models and reports stay)
	rm -rf .venv
