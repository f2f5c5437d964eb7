# make demo: the emulated lab cell, a leader and the camera follower, for DEMO_S seconds.
# make test: lint, types, rooms and tests.
# Both need Python 3.11 or newer with venv, and make.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

VENV := .venv
BIN := $(VENV)/bin
# each says by its name which extras are installed: what a user needs, that and the site's tools, all that tests need
USERS := $(VENV)/.installed-all
SITE := $(VENV)/.installed-all,docs
INSTALLED := $(VENV)/.installed-dev,docs
QUIETLY := --quiet --disable-pip-version-check
WANTED = -c constraints.txt --no-build-isolation -e '.[$*]'
COMPILED := compiled-gate compiled-camera compiled-modes
# and what tests need of arms that are not shipped
TESTED := $(COMPILED) compiled-arms
DEMO_S ?= 60
# how many mutants are judged at a time, and of which modules; of all if none is given
JOBS ?= 1
# the camera's laws to compile ahead; all if none is given
LAWS ?=
MODULES ?=
# the base image of the container; it needs Python 3.11 or newer with venv
BASE ?= python:3.11-slim-bookworm

# Python compiles a module once and keeps that, also where the environment forbids it: tests start hundreds of processes
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help install $(TESTED) demo test test-live test-services test-rest quick lint nightly mutation container-test wheels image docs site site-version figures constraints clean

help: ## show this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

install: $(USERS) ## make .venv, install what a user needs, and compile what the first start would
	@$(MAKE) --no-print-directory --jobs=2 $(COMPILED) LAWS=qp INSTALLED=$(USERS)

# what is imported is compiled then: all modules of all packages take a minute. uv takes a sixth of pip's time; pip
# installs where packages come from an index that only pip was told about
$(VENV)/.installed-%: pyproject.toml constraints.txt
	@python=$$(for name in python3.11 python3.12 python3.13 python3 python; do \
	  "$$name" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	    && { command -v "$$name"; break; }; done || true); \
	if [ -z "$$python" ]; then \
	  echo "error: no Python 3.11 or newer with venv was found; install one" \
	    "(on Debian and Ubuntu: apt install python3 python3-venv)" >&2; exit 1; fi; \
	echo "installing into $(VENV) with $$python"; \
	[ -x $(BIN)/python ] || "$$python" -m venv $(VENV)
	$(BIN)/python -m pip install $(QUIETLY) -c constraints.txt hatchling editables
	$(BIN)/python -m pip install $(QUIETLY) --only-binary uv -c constraints.txt uv \
	  && $(BIN)/uv pip install --quiet --system-certs --python $(BIN)/python $(WANTED) \
	  || { echo "not with uv: pip looks where it was told to"; \
	    $(BIN)/python -m pip install $(QUIETLY) --no-compile $(WANTED); }
	touch $@

# they do nothing where the machine code of these very sources is kept
compiled-gate: $(INSTALLED)
	@$(BIN)/python -m deltaq_cell

compiled-camera: $(INSTALLED)
	@$(BIN)/python -m deltaq_controllers.camera $(LAWS)

compiled-modes: $(INSTALLED)
	@$(BIN)/python -m deltaq_controllers.modes

compiled-arms: $(INSTALLED)
	@$(BIN)/python tests/support/published_arms.py

demo: $(USERS) ## start the emulated lab cell and let the camera follow, for DEMO_S seconds
	$(BIN)/deltaq demo --duration-s $(DEMO_S)

test: $(INSTALLED) ## lint, types, rooms, tests
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target compiled-gate compiled-modes lint compiled-camera compiled-arms
	@echo "single services, and beside them all that starts none; each is shown as it ends"
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target TESTED= test-services test-rest
	@echo "whole cells, one at a time and nothing beside them: their services come before everything else"
	@$(MAKE) --no-print-directory TESTED= test-live

test-live: $(INSTALLED) $(TESTED)
	$(BIN)/pytest -m live

test-services: $(INSTALLED) $(TESTED)
	$(BIN)/pytest -m service

# one worker more than two cores have: some of these tests wait
test-rest: $(INSTALLED) $(TESTED)
	nice -n 10 $(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder -m 'not live and not service'

quick: $(INSTALLED) $(TESTED) lint ## lint, types, rooms, and the tests that take little time
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder -m 'not live and not service and not long' \
		--durations=5 --durations-min=2

lint: $(INSTALLED) ## lint, format, types, rooms
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

nightly: $(INSTALLED) ## the long proofs
	$(BIN)/pytest -m nightly
	$(BIN)/pytest -m 'hypothesis and not nightly' --hypothesis-profile exploring

mutation: $(INSTALLED) ## change gate and guards in small ways, and see each change fail a test; takes a while
	$(BIN)/python tests/mutation/judge_mutants.py $(JOBS) $(MODULES)

docs: $(INSTALLED) ## write docs/reference, and in deploy compose files and systemd units, anew from the code
	PYTHONPATH=tools $(BIN)/python -m reference_pages
	$(BIN)/python -m deltaq_deploy.launch.compose lab > deploy/compose.yaml
	$(BIN)/python -m deltaq_deploy.launch.compose lab --real-time > deploy/realtime.yaml
	$(BIN)/python -m deltaq_deploy.launch.systemd lab --to deploy/systemd

site: $(SITE) ## the documentation as a site, with search and the Python API, in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "look at it with: $(BIN)/python -m http.server --bind 127.0.0.1 --directory build/site"

site-version: $(SITE) ## commit the site to the branch gh-pages as a version of its own, beside those before it
	PATH="$(CURDIR)/$(BIN):$$PATH" NO_MKDOCS_2_WARNING=1 $(BIN)/mike deploy --update-aliases \
	  "$$($(BIN)/deltaq --version | cut -d' ' -f2)" latest

figures: $(INSTALLED) ## run the paper's experiments and write camera-figures.md and attack-figures.md anew; takes hours
	$(BIN)/python -m studies.claims

wheels: $(USERS) ## the wheels that the image installs, so that its build needs no Python package index
	rm -rf build/wheels
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check -c constraints.txt \
	  --no-build-isolation -w build/wheels '.[all]'

image: wheels ## build the container image deltaq
	docker build --build-arg BASE=$(BASE) --build-arg WHEELS=build/wheels -f deploy/Dockerfile -t deltaq .

container-test: $(INSTALLED) image ## bring the stack up on a real engine and move a robot from outside
	$(BIN)/pytest -m container --timeout 600

constraints: $(INSTALLED) ## pin what is installed now
	$(BIN)/python -m pip freeze --exclude-editable | grep -E '^[A-Za-z0-9._-]+==' >constraints.txt

clean: ## remove everything that was made
	rm -rf $(VENV) build dist
