# Two commands: `make demo` and `make test`. Each sets up the local environment .venv first, if it has to.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
BUILD_FILES := pyproject.toml setup.py CMakeLists.txt package.xml $(wildcard cmake/*.cmake) $(wildcard msg/*.msg)
export VIRTUAL_ENV := $(CURDIR)/$(VENV)

.PHONY: help demo test test-lowest test-package lint docs studies clean
help:
	@echo "make demo   see the knee of a walking person: real node, real topics, recording, table"
	@echo "make test   run the tests"
	@echo "make test-lowest  the same with the lowest versions that are allowed, without Rerun, in an environment of its own"
	@echo "make test-package  build source distribution and wheels of all systems, install them in new environments and use them (three minutes)"
	@echo "make lint   formatter, linters and type checker"
	@echo "make docs   all pages and the interface as a site, in site/index.html; a broken link ends it"
	@echo "make studies  measure accuracy, honesty, long runs, budgets, stability and the choice of levels again, the reproduction of the paper, and 10 000 arthritic knees (over an hour)"
	@echo "make clean  remove what was built and the local environment"

demo: $(VENV)/.installed
	$(BIN)/knee-contact demo $(ARGS)

# In the order of tests/conftest.py: by itself pytest-xdist runs all files of the live node first, which mostly wait.
test: $(VENV)/.installed-dev
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --numprocesses 4 --dist loadgroup --no-loadscope-reorder --max-worker-restart 0 $(ARGS)

# Of what has wheels for this Python: NumPy 1.26 and SciPy 1.11, as in Ubuntu 24.04, up to Python 3.12. Rerun needs NumPy 2.
LOWEST := .venv-lowest
test-lowest: | $(BIN)/uv
	$(PYTHON) -m venv --clear $(LOWEST)
	VIRTUAL_ENV=$(CURDIR)/$(LOWEST) $(BIN)/uv pip install --quiet --resolution lowest-direct \
		--only-binary :all: --no-binary empy --config-settings messages=yes --editable '.[ros]' --group dev
	$(LOWEST)/bin/python -m pytest --numprocesses 2 --dist loadgroup --no-loadscope-reorder --max-worker-restart 0 $(ARGS)

test-package: $(VENV)/.installed-dev
	$(BIN)/python -m pytest tests/packaging/check_*.py $(ARGS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.installed-dev
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -c docs -D root_doc=README -d build/docs . site
	@echo "== Links to elsewhere, which are not looked up:"
	@$(BIN)/sphinx-build --quiet -b linkcheck -c docs -D root_doc=README -D linkcheck_ignore=.* -d build/docs . build/links
	@grep --only-matching '"uri": "http[^"]*' build/links/output.json | cut --characters 9- | sort --unique
	@echo "== site/index.html"

studies: $(VENV)/.installed-dev
	$(BIN)/python -m studies.accuracy
	for study in scenes tight changes measured cut budgets long_runs; do $(BIN)/python -m studies.honesty $$study; done
	$(BIN)/python -m studies.stability
	$(BIN)/python -m studies.choosing
	$(BIN)/python -m studies.reproduction
	$(BIN)/python -m studies.osteoarthritis
	$(BIN)/python -m studies.validation

clean:
	rm -rf $(VENV) $(LOWEST) build site *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

$(BIN)/uv:
	@for tool in $(PYTHON) cc c++; do command -v $$tool >/dev/null || \
		{ echo "$$tool is missing; on Debian: apt install python3-venv gcc g++ make" >&2; exit 1; }; done
	@echo "== Making a local Python environment in $(VENV)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "uv>=0.5"

$(VENV)/.installed: $(BUILD_FILES) | $(BIN)/uv
	@echo "== Installing ROS 2 Jazzy and the other dependencies, and building the messages (half a minute the first time)"
	$(BIN)/uv pip install --quiet --config-settings messages=yes --editable '.[ros,viewer,report]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	@echo "== Installing the tools for tests and checks"
	$(BIN)/uv pip install --quiet --compile-bytecode --group dev
	@touch $@
