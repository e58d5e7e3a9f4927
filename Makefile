# `make demo` and `make test` do all the set-up: a virtual environment in .venv, exact versions.
PYTHON ?= python3
VENV ?= .venv
PIP_FLAGS ?=
# PyTorch for CPUs, 0.2 GB; `make demo TORCH=cuda` takes PyPI's build, 3 GB, for a GPU.
TORCH ?= cpu
OUT ?= out/demo
# One more than there are cores: browsers and processes that tests start are waited for.
JOBS ?= $(shell echo $$(( $$(nproc 2>/dev/null || echo 2) + 1 )))
# Of make test: one folder below tests/, with ruff alone before it.
FOLDER ?=
# Of make explore: readers (names, patterns, commas), examples of each, the first seed.
READERS ?= *
COUNT ?= 2000
SEED ?= $(shell date +%s)
# Of make mutants: faults by patterns, each in quotes.
FAULTS ?= '*'
OUTPUT ?= out/explore

PY := $(VENV)/bin/python
INSTALL := PIP_FLAGS="$(PIP_FLAGS)" tools/install.sh $(PY) -c constraints.txt
# One thread a process: the tests run in parallel processes.
TEST_ENV := OMP_NUM_THREADS=1 MPLBACKEND=Agg
# Bytecode is kept, whatever the user's setting: each process would compile anew what it imports, and
# rewrite the tests' assertions.
export PYTHONDONTWRITEBYTECODE :=
# In the order of tests/conftest.py.
PYTEST := $(TEST_ENV) $(PY) -m pytest -q -n $(JOBS) --dist loadfile --no-loadscope-reorder
NOTEBOOKS := --nbmake --nbmake-timeout=600 notebooks

.PHONY: help demo test thorough ci style lint types check dear both slow explore mutants notebook docs wheel lowest doctor clean

help:
	@echo "make demo      run the main job on real captures: $(OUT)/report/report.html"
	@echo "make test      linters, type checker, import contracts, tests of every promise: minutes"
	@echo "               FOLDER=calibration/color: ruff and all fast tests of one folder"
	@echo "make thorough  the dearer tests, notebooks, documentation, wheel"
	@echo "make ci        both at once, as continuous integration does"
	@echo "make slow      the tests that take minutes"
	@echo "make explore   damaged files and property-based tests never tried before"
	@echo "               READERS=import-* COUNT=2000 SEED=1 OUTPUT=out/explore"
	@echo "make mutants   plant faults in the product: do the tests notice them?"
	@echo "make notebook  execute the notebooks"
	@echo "make docs      the documentation as a site: out/docs/index.html"
	@echo "make wheel     build sdist and wheel, install the wheel elsewhere and use it there"
	@echo "make lowest    the lowest allowed versions, once a release: commands and their tests"
	@echo "make doctor    is this installation complete?"
	@echo "make clean     remove .venv, out and caches"

demo: $(VENV)/.installed-demo
	$(VENV)/bin/taccel-lab demo --out $(OUT)

# The type checker runs beside the tests: one waits on what the other does not.
test: style
	$(MAKE) -j2 $(if $(FOLDER),,types) check

style: $(VENV)/.installed-dev
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

lint: style types

types: $(VENV)/.installed-dev
	$(VENV)/bin/pyright --pythonpath $(PY)
	$(VENV)/bin/lint-imports

check: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow$(if $(FOLDER),, and not thorough)" tests/$(FOLDER)

# What takes one core goes on beside the tests, one after the other.
thorough: $(VENV)/.installed-dev
	$(MAKE) -j2 dear notebook wheel docs

dear: $(VENV)/.installed-dev
	$(PYTEST) -m "thorough and not slow" tests

# In one run of pytest what is imported and collected, and what several tests start from, is so once.
ci: style
	$(MAKE) -j2 both types wheel docs

both: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow" tests $(NOTEBOOKS)

slow: $(VENV)/.installed-peers
	$(PYTEST) -m slow

explore: $(VENV)/.installed-dev
	$(TEST_ENV) $(PY) -m tests.fuzz --readers '$(READERS)' --count $(COUNT) --first $(SEED) \
		--output $(OUTPUT)
	TACCEL_LAB_EXPLORE=1 $(PYTEST) -m "hypothesis and not slow and not gpu"

mutants: $(VENV)/.installed-dev
	$(TEST_ENV) $(PY) -m tests.mutants --only $(FAULTS)

notebook: $(VENV)/.installed-dev
	$(PYTEST) $(NOTEBOOKS)

docs: $(VENV)/.installed-dev
	$(TEST_ENV) $(PY) -m sphinx -b html -W --keep-going -q docs out/docs
	@echo "out/docs/index.html"

wheel: $(VENV)/.installed-dev
	PIP_FLAGS="$(PIP_FLAGS)" tools/try_wheel.sh $(PYTHON) $(PY)

lowest: $(VENV)/.installed-dev
	PIP_FLAGS="$(PIP_FLAGS)" tools/try_lowest.sh $(PYTHON) $(PY)

doctor: $(VENV)/.installed-demo
	$(VENV)/bin/taccel-lab doctor

$(VENV)/.installed-demo: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11"; exit 1; }
	@PATH="$$PATH:/usr/sbin:/sbin" tools/system_libraries.sh
	@echo "Installing into $(VENV), once."
	$(PYTHON) -m venv $(VENV)
	$(if $(filter cuda,$(TORCH)),,@PIP_FLAGS="$(PIP_FLAGS)" tools/cpu_torch.sh $(PY))
	$(INSTALL) -e ".[demo,video,view]"
	@$(PY) -c 'import build123d' || \
		{ echo "A system library is missing; on Debian: apt install libgl1 libx11-6 libexpat1"; exit 1; }
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed-demo
	@tools/system_libraries.sh --browser
	$(INSTALL) -e ".[demo,dev,docs,repair]"
	@touch $@

$(VENV)/.installed-peers: $(VENV)/.installed-dev
	$(INSTALL) -e ".[demo,dev,peers,robots,newton]"
	@touch $@

clean:
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
