# make demo and make test do all set-up by themselves; PYTHON=python3.12 chooses another interpreter.
PYTHON ?= python3
VENV := .venv
# Further options of pytest: make test OPTIONS="-k solver --durations=10"
OPTIONS ?=
# A process for each core; contiguous halves of the suite share their modules' fixtures, and idle processes take over.
PARALLEL := -n logical --dist worksteal
# All matrices are small: more BLAS threads only wait on each other.
export OPENBLAS_NUM_THREADS := 1
# pip would compile every module, of which few are imported; Python keeps those that it compiles itself.
PIP := $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-compile
unexport PYTHONDONTWRITEBYTECODE
BIN := $(VENV)/bin
# The program, and with it all that its developers use.
RUNS := $(VENV)/.runs
READY := $(VENV)/.ready

.PHONY: demo test laws sentences coverage check docs pictures package benchmarks clean

demo: $(RUNS)
	$(BIN)/duplex demo

test: $(READY)
	$(BIN)/python -m pytest -q $(PARALLEL) $(OPTIONS)

# The laws (hypothesis) with 200 examples each instead of ten, other ones in each run.
laws: $(READY)
	$(BIN)/python -m pytest -q $(PARALLEL) -m hypothesis --hypothesis-profile laws $(OPTIONS)

# Writes what users read to tests/data/sentences; git diff shows what changed.
sentences: $(READY)
	REWRITE_SENTENCES=1 $(BIN)/python -m pytest -q -k test_sentences tests/recordings tests/viewer_app

# Numba's kernels run compiled, which coverage.py cannot see; pyproject.toml leaves them out and says why.
coverage: $(READY)
	$(BIN)/python -m pytest -q $(PARALLEL) --cov --cov-report= tests/fusion tests/recordings $(OPTIONS)
	$(BIN)/coverage report

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	for platform in win32 darwin; do \
	  $(BIN)/mypy --platform $$platform --no-warn-unreachable --cache-dir .mypy_cache/$$platform || exit; \
	done
	$(BIN)/lint-imports
	$(BIN)/python -m tests.ledger
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# The documentation as a site in site/; make docs OPTIONS="serve" shows it while it is edited.
docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs $(if $(OPTIONS),$(OPTIONS),build --strict)

# The pictures of the documentation, and the outputs of the notebook; needs a graphics driver or mesa-vulkan-drivers.
pictures: $(READY)
	$(BIN)/python -m tests.experiments.notebook
	$(BIN)/python -m tests.experiments.placement_picture
	$(BIN)/python -m tests.experiments.surface_picture
	$(BIN)/python -m tests.experiments.moving_picture
	$(BIN)/python -m tests.experiments.layout_pictures

# An sdist and a wheel in dist/, checked and tried in a fresh environment.
package: $(READY)
	.ci/package dist

# docs/benchmarks.md from the figures that the benchmarks left; CONTRIBUTING.md says how they are measured.
benchmarks: $(READY)
	$(BIN)/python -m tests.benchmarks.page

clean:
	rm -rf $(VENV)

$(RUNS): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "duplex-kinects needs Python 3.11 or newer; $(PYTHON) is older. Try: make PYTHON=python3.12"; exit 1; }
	@echo "Installing the program and its libraries, and compiling its kernels meanwhile."
	@n=0; while sleep 3 && kill -0 $$$$ 2>/dev/null; do n=$$((n + 3)); echo "Installing, $$n s …"; done & \
	{ $(PYTHON) -m venv $(VENV) || \
	  { $(PYTHON) -m pip install --user virtualenv && $(PYTHON) -m virtualenv --clear $(VENV); }; } && \
	$(PIP) numba && \
	{ $(BIN)/python -m fusion.compiling.first_run fusion.estimator.duplex_fusion:compile_estimator > /dev/null 2>&1 & } && \
	$(PIP) --editable . && { wait $$! || true; }
	@touch $@

$(READY): $(RUNS)
	$(PIP) --editable '.[dev]'
	@$(BIN)/duplex tracker fetch || echo "Without the networks the body tracker cannot run; all else works."
	@touch $@
