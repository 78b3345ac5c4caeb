# Every target does its own set-up, once: it needs git, make and Python 3.11 or newer, no more.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
BENCH_STAMP := .venv-bench/.ready
DOCS_STAMP := .venv-docs/.ready

NODE := $(abspath $(VENV))/.node/bin
PAGE := src/threadline/panel/page/index.html

# Byte code is kept: without it each interpreter that tests start reads 180 000 lines anew, a second.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo docs panel wheel test test-all test-cores bench lint format fuzz soak lock clean

$(STAMP): requirements/dev.txt pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Threadline needs Python 3.11 or newer; set PYTHON=..."; exit 2; }
	@echo "Setting up $(VENV) (once, about two minutes)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r requirements/dev.txt
	@# pip writes byte code on one core, which is half of its work. This uses all cores.
	@$(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true  # a few files are templates
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

panel: $(PAGE)  ## Lint, test and build the page of the operator's panel

$(PAGE): $(STAMP) requirements/panel.txt $(wildcard web/*.*) $(wildcard web/src/* web/tests/* web/public/*)
	@command -v npm >/dev/null 2>&1 || $(BIN)/python -m tools.node_programs $(NODE)
	cd web && PATH="$$PATH:$(NODE)" npm ci --no-audit --no-fund && PATH="$$PATH:$(NODE)" npm run build

wheel: $(PAGE)  ## Build the wheel, with the panel's page, and try it in a bare environment
	rm -rf build dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	$(BIN)/python -m tools.try_wheel dist/*.whl

demo: $(STAMP)  ## Prove the cone-dome-cylinder program on the simulated winder
	$(BIN)/threadline prove examples/cone-dome-cylinder.prg -m lathe-winder --interpolation optimal --report reports/demo

test: $(STAMP)  ## Run all tests but the long ones, on every core
	$(BIN)/python -m pytest -n auto --dist worksteal --without-long

test-all: $(STAMP)  ## Run all tests, on every core
	$(BIN)/python -m pytest -n auto --dist worksteal

test-cores: $(STAMP)  ## Run the tests of the numerics as other processors round
	$(BIN)/python -m tools.core_types --others

lint: $(STAMP)  ## Linters, types and the rules of the house
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(BENCH_STAMP): requirements/bench.txt pyproject.toml
	$(PYTHON) -m venv .venv-bench
	.venv-bench/bin/python -m pip install --quiet --require-hashes -r requirements/bench.txt
	.venv-bench/bin/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

$(DOCS_STAMP): requirements/docs.txt
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --require-hashes -r requirements/docs.txt
	@touch $@

docs: $(DOCS_STAMP)  ## Build the site of the documents into build/site; a warning is an error
	NO_MKDOCS_2_WARNING=1 .venv-docs/bin/mkdocs build --strict

bench: $(BENCH_STAMP)  ## Compare with peers in one run; writes benchmarks/results.json
	.venv-bench/bin/python -m benchmarks

fuzz: $(STAMP)  ## A million hostile inputs, 100 000 changes that must not matter, two hours of hostile command lines, 400 interrupts
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz --cases 1000000
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz_every_kind --rounds 30
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz_commands --minutes 120
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.fuzz_interrupts --cases 400

soak: $(STAMP)  ## A day of simulated running at 100 times real time, and 200 kills
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.soak

lock:  ## Renew the locked requirements (needs uv)
	for name in run cluster dev bench panel docs; do \
	  case $$name in run) from=pyproject.toml;; cluster) from="--extra cluster -c requirements/run.txt pyproject.toml";; \
	    panel|docs) from=requirements/$$name.in;; \
	    *) from="--extra cluster pyproject.toml requirements/$$name.in";; esac; \
	  uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	    --custom-compile-command "make lock" $$from -o requirements/$$name.txt || exit 2; \
	done

clean:
	rm -rf $(VENV) .venv-bench .venv-docs build dist reports .pytest_cache .mypy_cache .ruff_cache
