# Everything a user or a developer runs; each target sets up .venv by itself when it is missing or stale.
PYTHON ?= python3
BIN := .venv/bin
OUT ?= runs/pendulum

.PHONY: help setup train test slow lint figures bench wheel site release-check

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

setup: .venv/.ready  ## create .venv with torch and this package, editable: some minutes, 2 GB

.venv/.ready: pyproject.toml
	@echo "setting up .venv, some minutes"
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	@touch $@

train: setup  ## train the curious agent on PendulumSwingup with action cost, under 4 minutes
	$(BIN)/python scripts/train.py --env-id PendulumSwingup --env-kwargs action_cost 0.1 \
		--total-steps 16000 --hidden-dim 64 --out $(OUT)

test: setup  ## the default tests, some 5 minutes on two cores
	$(BIN)/python -m pytest -n auto

slow: setup  ## the learning tests, tens of minutes
	$(BIN)/python -m pytest -m slow

lint: setup  ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy scripts/*.py

figures: setup  ## run every study and write docs/study and docs/sweeps, about a day on 2 cores
	for study in goals sparse control mountain_car bonuses subsampling \
			stable_baselines3 torchrl clever_random reliable \
			noise parts battery hunger alpha frame_stack default hopper ends horizon prior \
			motors marginal "rate --tasks PendulumSwingup" "rate --tasks HalfCheetah-v5"; do \
		$(BIN)/python scripts/study.py $$study || exit 1; done

bench: setup  ## speed, floor, memory and growth into docs/benchmark, half an hour on an idle machine
	$(BIN)/python scripts/benchmark.py

wheel: setup  ## build the wheel into dist/
	$(BIN)/python -m build --wheel --outdir dist

site: setup  ## the documentation into site/, a page of it for every page of docs/
	$(BIN)/python -m sphinx --fail-on-warning --quiet -b html docs site
	$(BIN)/python docs/check_links.py site

release-check: setup  ## wheel and sdist into dist/, and all that a new user does, in an empty environment
	PYTHON=$(PYTHON) .ci/release-check
