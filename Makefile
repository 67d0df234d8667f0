# `make demo` and `make test` need python3 (3.11 or newer) and nothing else: each makes .venv once and
# installs there what it needs. `make PYTHON=python3.12 test` chooses another interpreter.
PYTHON ?= python3
VENV := .venv
# The oldest versions that pyproject.toml declares have wheels for these two.
OLDEST_PYTHONS ?= python3.11 python3.12 $(PYTHON)
OLDEST := .venv-oldest
FRESH := .venv-wheel
KERNELS := $(VENV)/numba-cache
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
OUTPUT := examples/board/output
NUMERICS := $(BIN)/python -m pytest -n logical --maxprocesses 8 -m numerics \
  $(patsubst %,tests/test_%.py,prior tracker resultants polynomial tensor invariants assignment hypotheses \
  model point_set_model two_view_model visibility)
SOURCES := $(shell find src -name '*.py')

.PHONY: help demo test fuzz torture adversary smoke-oldest smoke-processors lint format docs clean

help:
	@echo "make demo    match the chessboard photograph of examples/board and draw the result"
	@echo "make test    run the whole test suite (make test ARGS='-k board' runs a part)"
	@echo "make fuzz    try ten thousand calls, twenty thousand command lines and a hundred thousand files; goes on where it stopped"
	@echo "make torture kill sweeps and runs of frames a hundred times each, and whatever else takes long to break"
	@echo "make adversary  a thousand random scenes, in search of one that is trusted and wrong"
	@echo "make wheel   a wheel with compiled kernels for this Python, and the sdist it is built from, into dist; both checked"
	@echo "make smoke-wheel  what the README shows, from that wheel in an environment of its own, compiling nothing"
	@echo "make smoke-oldest  a small part of it with the oldest versions that pyproject.toml declares"
	@echo "make smoke-processors  the tests of arithmetic as an old and a recent processor do it"
	@echo "make lint    ruff, mypy and the import layers"
	@echo "make docs    build the site into docs/_build/html, its examples run, warnings are errors"
	@echo "make format  let ruff put the code in order"
	@echo "make clean   remove .venv, caches and what the demonstration wrote"

demo: $(VENV)/runtime.stamp $(VENV)/kernels.stamp
	NUMBA_CACHE_DIR=$(KERNELS) $(BIN)/python examples/board/demo.py --output $(OUTPUT)

test: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n logical --maxprocesses 8 --dist worksteal $(ARGS)

# Minutes to an hour: .fuzz.json says how far it came. What fails is kept in tests/fuzz/kept and is a test from then on.
fuzz: $(VENV)/dev.stamp $(VENV)/kernels.stamp
	NUMBA_CACHE_DIR=$(KERNELS) $(BIN)/python tests/fuzz/run_cases.py $(ARGS)

torture: $(VENV)/dev.stamp
	ROOTMATCH_TORTURE=1 $(BIN)/python -m pytest -n logical --maxprocesses 8 tests/test_torture.py $(ARGS)

adversary: $(VENV)/dev.stamp $(VENV)/kernels.stamp
	NUMBA_CACHE_DIR=$(KERNELS) $(BIN)/python benchmarks/adversary.py --scenes 1000 --first-seed 3000000 $(ARGS)

# The wheel is built from the sdist, so both are tried.
wheel: $(VENV)/dev.stamp
	rm -rf dist
	ROOTMATCH_PREBUILD=1 $(BIN)/python -m build --outdir dist .
	$(BIN)/python -m twine check --strict dist/*

smoke-wheel: wheel
	rm -rf $(FRESH)
	$(BIN)/python -m venv --without-pip $(FRESH)
	$(PIP) --python $(FRESH)/bin/python install -q "$$(ls dist/*.whl)" pytest
	cd $(FRESH) && env -u PYTHONPATH NUMBA_CACHE_DIR=numba-cache bin/python -m pytest -p no:cacheprovider --rootdir .. \
	  ../tests/test_prebuilt.py
	rm -rf $(FRESH)

smoke-oldest: $(OLDEST)/made.stamp
	@test ! -x $(OLDEST)/bin/python || NUMBA_CACHE_DIR=$(OLDEST)/numba-cache PYTHONPATH=src \
	  $(OLDEST)/bin/python -m pytest -n logical --maxprocesses 8 -p no:cacheprovider tests/test_smoke.py

# OpenBLAS has other kernels for each core type, and with them other signs of singular vectors and another last digit; Numba
# without the processor's features fuses no products into sums. `pytest -m numerics` without files is all of it.
smoke-processors: $(VENV)/dev.stamp
	OPENBLAS_CORETYPE=Prescott NUMBA_CPU_NAME=generic $(NUMERICS)
	OPENBLAS_CORETYPE=Haswell $(NUMERICS)

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/docs.stamp $(VENV)/kernels.stamp
	NUMBA_CACHE_DIR=$(CURDIR)/$(VENV)/numba-cache $(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html
	@echo "The site is in docs/_build/html/index.html"

clean:
	rm -rf $(VENV) $(OLDEST) $(FRESH) $(OUTPUT) docs/_build docs/gallery docs/concepts build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests examples benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# Some systems split venv's pip (ensurepip) off their python3; where pip itself is there it can fill the new .venv.
$(VENV)/made.stamp:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "rootmatch needs Python 3.11 or newer, but '$(PYTHON)' is missing or older: $$($(PYTHON) --version 2>&1)." >&2; \
	  echo "Install one and name it, for example: make PYTHON=python3.12 demo" >&2; exit 1; }
	rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV) >$(VENV).log 2>&1 \
	|| { rm -rf $(VENV); $(PYTHON) -m venv --without-pip $(VENV) && $(PYTHON) -m pip --python $(BIN)/python install -q pip; } >>$(VENV).log 2>&1 \
	|| { cat $(VENV).log >&2; rm -rf $(VENV) $(VENV).log; \
	  echo "'$(PYTHON) -m venv' failed; on Debian and Ubuntu install the package python3-venv, then try again." >&2; exit 1; }
	@rm -f $(VENV).log
	@touch $@

$(VENV)/runtime.stamp: $(VENV)/made.stamp pyproject.toml src/rootmatch/_version.py
	@echo "Installing rootmatch and what it needs into $(VENV) (once; a minute or two)"
	$(PIP) install -q -e .
	@touch $@

$(VENV)/dev.stamp: $(VENV)/made.stamp pyproject.toml src/rootmatch/_version.py
	@echo "Installing rootmatch with what its tests and checks need into $(VENV) (once; a few minutes)"
	$(PIP) install -q -e '.[dev]'
	@touch $(VENV)/runtime.stamp $@

$(VENV)/docs.stamp: $(VENV)/made.stamp pyproject.toml src/rootmatch/_version.py
	@echo "Installing rootmatch with what its site is built with into $(VENV) (once; a minute or two)"
	$(PIP) install -q -e '.[docs]'
	@touch $(VENV)/runtime.stamp $@

$(OLDEST)/made.stamp: pyproject.toml .ci/oldest.py
	@rm -rf $(OLDEST)
	@mkdir $(OLDEST)
	@for python in $(OLDEST_PYTHONS); do \
	  $$python -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' 2>/dev/null || continue; \
	  echo "Installing the oldest versions declared into $(OLDEST) (once; a minute or two)"; \
	  { $$python -m venv $(OLDEST) >$(OLDEST)/log 2>&1 \
	    || { $$python -m venv --clear --without-pip $(OLDEST) && $$python -m pip --python $(OLDEST)/bin/python install -q pip; } \
	    && $(OLDEST)/bin/python .ci/oldest.py symbolic test:pytest test:pytest-xdist >$(OLDEST)/pins.txt \
	    && $(OLDEST)/bin/python -m pip --disable-pip-version-check install -q -r $(OLDEST)/pins.txt; } || exit 1; \
	  touch $@; exit 0; \
	done; \
	echo "Left out: no Python 3.11 or 3.12 here, and the oldest versions declared have no wheels for newer ones." >&2; \
	rm -rf $(OLDEST)

# So that the demonstration itself waits for no compiler. What is compiled of other sources is found to be so.
$(VENV)/kernels.stamp: $(VENV)/runtime.stamp $(SOURCES)
	@echo "Compiling kernels (once; half a minute on two cores)"
	NUMBA_CACHE_DIR=$(KERNELS) $(BIN)/rootmatch warmup
	@touch $@
