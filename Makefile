# Two commands are all that a user needs: `make demo` and `make test`. Each builds .venv when it is missing
# or out of date, and costs nothing extra when it is there.

PYTHON ?= python3
JOBS ?= 2
EXAMPLES ?= 2000
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed

# The arrays are small: a second thread inside torch or numpy makes them slower, processes make them faster.
export OMP_NUM_THREADS := 1
export MPLBACKEND := Agg

.DEFAULT_GOAL := help
.PHONY: help install demo test check benchmark-report soak fuzz audit docs format clean

help:  ## list the commands
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 18

install: $(INSTALLED)  ## make .venv and install everything that the other commands need

demo: $(INSTALLED)  ## identify a drive from its records and show the result (runs/demo)
	$(BIN)/hybrid-id demo --out runs/demo --force

test: $(INSTALLED)  ## run all tests
	$(BIN)/python -m pytest -q -n $(JOBS) --dist worksteal

check: $(INSTALLED)  ## lint, format and type checks
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

benchmark-report: $(INSTALLED)  ## diagnose 40 stored machines and hold the scores against their floors (half an hour)
	$(BIN)/python -m benchmarks.report --jobs $(JOBS)

soak: $(INSTALLED)  ## kill every long command at random moments and go on, 50 times each (three hours)
	$(BIN)/python tests/soak.py

fuzz: $(INSTALLED)  ## change files at random and let every reader read them, many times (EXAMPLES=2000)
	FUZZ=$(EXAMPLES) $(BIN)/python -m pytest -q -n $(JOBS) tests/test_robustness.py -k every_reader

docs: $(INSTALLED)  ## build the documentation (site/)
	$(BIN)/python -m mkdocs build --strict

audit: $(INSTALLED)  ## known vulnerabilities and licences of what is installed, and a bill of materials (build/sbom.json)
	.ci/audit $(VENV)

format: $(INSTALLED)  ## repair what ruff can repair
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove the environment and the caches, keep the results in runs/
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis

# Every package but torch is one whose hash requirements.lock gives (.ci/lock writes it). PyPI's torch for Linux brings
# gigabytes of CUDA, so its CPU build is fetched from PyTorch's own index; where that index cannot be reached, whatever
# build pip finds is taken, with what it needs.
$(INSTALLED): pyproject.toml constraints.txt requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "hybrid_id needs Python 3.11 or newer: make PYTHON=/path/to/python3.11"; exit 1; }
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --no-deps --require-hashes -r requirements.lock
	$(BIN)/pip install -q --retries 0 --timeout 15 --no-deps -c constraints.txt \
		--index-url https://download.pytorch.org/whl/cpu torch 2>/dev/null \
		|| { echo "PyTorch's own index was not reached: taking torch from pip's usual index."; \
			$(BIN)/pip install -q -c constraints.txt torch; }
	$(BIN)/pip install -q --no-deps --no-build-isolation -e .
	@$(BIN)/hybrid-id doctor --ahead > /dev/null 2>&1 || true
	@touch $@
