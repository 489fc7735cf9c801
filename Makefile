# Everything on a machine with only Python 3.11+, pip and make:
#   make demo    bench logs -> calibrated model -> trained agent -> demo/index.html
#   make test    lint, types, import contracts, guide, tests
#   make docs    the guide: build/guide/index.html
#   make lab     the notebooks, opened; make notebooks runs them and stores what they show
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO_MINUTES ?= 4

.PHONY: demo test check docs bench bench-logs notebooks lab setup clean

setup: $(READY)

# torch first and alone: everything else then accepts the build that is there.
$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt torch
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt -e '.[train,report,export,notebooks,docs,dev]'
	touch $@

demo: $(READY)
	$(BIN)/python -m frasa_rl.demo --minutes $(DEMO_MINUTES) --out demo

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(READY)
	$(BIN)/sphinx-build -q -W -n --keep-going notebooks/guide build/guide

test: check docs
	$(BIN)/pytest -n 2 --dist loadfile

bench: $(READY)
	for file in tests/benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

# The project's own logs, message for message (with the versions of constraints.txt).
bench-logs: $(READY)
	$(BIN)/frasa-sysid simulate --servo mx106 --out bench_logs/mx106.mcap
	$(BIN)/frasa-sysid simulate --servo mx64 --out bench_logs/mx64.mcap
	$(BIN)/frasa-sysid simulate --robot --base both --seed 1 --seconds 25 --out bench_logs/robot.mcap

# Every notebook from its plain text, with what it shows, into the .ipynb beside it.
notebooks: $(READY)
	$(BIN)/python tests/notebooks/refresh.py

# JupyterLab is not part of the set-up: it is large, and any other Jupyter or editor opens the notebooks too.
lab: $(READY)
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt jupyterlab
	$(BIN)/jupyter lab notebooks

clean:
	rm -rf demo runs build notebooks/guide/generated .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
