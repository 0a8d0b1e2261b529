# Two commands on a fresh machine: `make demo` and `make test`. Both set up .venv first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test bench lint sample-frames clean help

help:
	@echo "make demo   set up, then run the main job on sample_frames/ into out/demo/"
	@echo "make test   set up, then run the tests"
	@echo "make bench  set up, then run the benchmarks (minutes; not part of the tests)"
	@echo "make lint   check the style"

demo: $(READY)
	$(BIN)/calibench demo --out out/demo

test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadfile

bench: $(READY)
	$(BIN)/python -m pytest tests/benchmarks -s -q -o python_files='bench_*.py'

lint: $(READY)
	$(BIN)/ruff check calibench tests

# Renders the committed sample session anew (seeded: the same frames again).
sample-frames: $(READY)
	rm -rf sample_frames
	$(BIN)/calibench simulate session sample_frames --plan sample --seed 1

$(READY): pyproject.toml .ci/constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "python3 is missing: apt-get install python3 python3-venv"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed, this is $$($(PYTHON) --version): apt-get install python3.11 python3.11-venv, then make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "the venv module is missing: apt-get install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c .ci/constraints.txt -e ".[dev]"
	@touch $(READY)

clean:
	rm -rf $(VENV) out
