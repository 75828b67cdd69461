# Every target makes the environment by itself; nothing else is needed but Python 3.11 or newer.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test install bench fuzz lint clean
run: .venv/installed
	$(BIN)/kincal run ups3_s

test: .venv/installed
	$(BIN)/python -m pytest -n 2

install: .venv/installed

bench: .venv/installed
	$(BIN)/python -m benchmarks

fuzz: .venv/installed
	$(BIN)/python -m tests.fuzz --cases 20000 --commands 60

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

clean:
	rm -rf .venv .kincal

# The stamp is written last: an installation that broke off is taken up again.
.venv/installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@
