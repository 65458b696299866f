# Everything is installed into a virtual environment, .venv. Once it is there, every target works offline:
# packages are installed again only when pyproject.toml or setup.py has changed.
#
#   make demo PYTHON=python3.13        another Python (of a new environment)
#   make test PYTEST_FLAGS="-k gyro"   other flags for pytest
#   make bench AGAINST=HEAD~3          how many times as fast as that commit; BENCH_FLAGS="--scaling --write docs"
#   make mutants MUTANTS=cglr          those alone whose file or tests are so called; MUTANTS="--random 200" draws edits
#   make reproduce REPRODUCE_FLAGS="--only fig_5_6"   other options for `python -m reproduction`

PYTHON ?= python3
VENV := .venv
AGAINST ?= HEAD
PYTEST_FLAGS ?= -n 2 --dist worksteal
QUICK := tests/maths tests/systems tests/inputs tests/records tests/test_structure.py tests/test_landed_0_1.py \
    --ignore=tests/systems/autopilot/test_jet_selection_program_system.py

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
# built with the environment's own setuptools: an isolated build would download it anew each time
INSTALL := $(PIP) install --no-build-isolation

# folders count too: they are newer once a file in them has gone
PACKAGE := $(shell find -L massprop_drake -name __pycache__ -prune -o -print)

# what else is on the search path could shadow the environment
unexport PYTHONPATH PYTHONHOME
# tests start the program again and again: where nothing is kept, compiling it is a third of each start
unexport PYTHONDONTWRITEBYTECODE

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help demo test quick coverage mutants reproduce site docs lint types bench wheel release clean

help: ## shows this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1:\2/p' $(MAKEFILE_LIST) | awk -F: '{ printf "%-17s %s\n", $$1, $$2 }'

# the thesis's filters, then the joint one in the same flight
JOINT := --set 'estimation={filter: joint, start: zero}' --set 'joint={thrust_uncertainty: 0, tank_fraction: 0}' --set mass={} \
    --set detector.kind=off --no-report --no-figures --quiet

demo: $(VENV)/.installed ## estimates the orbiter's mass properties from the sample maneuver, by both filters
	$(BIN)/massprop run sample_maneuver
	$(BIN)/massprop run sample_maneuver $(JOINT) --out runs/sample_maneuver_joint
	$(BIN)/massprop compare runs/sample_maneuver runs/sample_maneuver_joint

test: $(VENV)/.installed-test ## runs all tests but those of the documentation
	$(BIN)/python -m pytest -m "not documentation" $(PYTEST_FLAGS)

quick: $(VENV)/.installed-test ## runs the tests that take a minute together: no browser, no long scenario
	$(BIN)/python -m pytest $(PYTEST_FLAGS) $(QUICK)

coverage: $(VENV)/.installed-test ## runs all tests and prints the share of the lines that they run
	$(BIN)/python -m pytest $(PYTEST_FLAGS) --cov=massprop_drake --cov=reproduction --cov-report=term:skip-covered

mutants: $(VENV)/.installed-test ## makes single edits and checks that tests notice each
	$(BIN)/python tests/mutants.py $(MUTANTS)

reproduce: $(VENV)/.installed ## reruns the thesis into runs/reproduction, claim by claim; ten minutes on two cores
	$(BIN)/python -m reproduction $(REPRODUCE_FLAGS)

site: $(VENV)/.installed-test ## builds the documentation into build/docs
	$(BIN)/sphinx-build -q -W --keep-going -n -j 2 -d build/doctrees docs build/docs

docs: site ## builds the documentation, and runs its tutorials and tests
	MASSPROP_SITE=build/docs $(BIN)/python -m pytest -m documentation $(PYTEST_FLAGS)
	@echo "build/docs/index.html"

lint: $(VENV)/.installed-dev ## checks style, format, spelling and words
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/python .ci/words.py

types: $(VENV)/.installed-dev ## checks types
	$(BIN)/mypy -p massprop_drake -p reproduction

bench: $(VENV)/.installed ## measures speed against another commit, AGAINST=<commit>; by compiled kernels, too, where numba is
	$(BIN)/python benchmarks/speed.py --against $(AGAINST) $(BENCH_FLAGS)

wheel: dist/.built ## builds the wheel into dist/

release: dist/.built site ## builds wheel, source distribution, site and card into dist/, and checks them
	rm -rf dist/*.tar.gz dist/site
	$(BIN)/python -c 'from setuptools.build_meta import build_sdist; build_sdist("dist")' >/dev/null
	cp -R build/docs dist/site
	cp docs/card.md dist/
	bash .ci/release dist $(BIN)/python

clean: ## removes environments, builds and caches; leaves runs/
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# ------------------------------------------------------------------------------------ environments

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "massprop_drake needs Python 3.11 or newer; name one with 'make PYTHON=python3.12 ...'" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	$(PIP) install "setuptools>=77"
	@touch $@

# each environment holds the one before it, so whatever order they are made in, nothing is made twice
$(VENV)/.installed: pyproject.toml setup.py $(VENV)/.created
	$(INSTALL) --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(INSTALL) --editable ".[test]"
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed-test
	$(INSTALL) --editable ".[dev]"
	@touch $@

# setuptools would pack what an earlier build left in build/lib
dist/.built: pyproject.toml setup.py README.md LICENSE $(PACKAGE) $(VENV)/.created
	rm -rf dist build/lib build/bdist.*
	$(PIP) wheel --no-build-isolation --no-deps --wheel-dir dist .
	@touch $@
