# Every target makes the environment by itself; nothing else is needed but Python 3.11 or newer.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test install bench damage fuzz lint package clean
run: .venv/installed
	$(BIN)/kincal run ups3_s

test: .venv/installed
	$(BIN)/python -m pytest -n 2

install: .venv/installed

bench: .venv/installed
	$(BIN)/python -m benchmarks

# What becomes of results when a store is damaged: docs/explanation/cache.md.
damage: .venv/installed
	$(BIN)/python -m benchmarks.damage

# Hostile input, many thousand cases: docs/explanation/hostile_input.md.
fuzz: .venv/installed
	$(BIN)/python -m tests.fuzz --cases 20000 --commands 60

# Formats, style, arrows between modules, types: every source file once.
lint: .venv/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/python -m pytest tests/lint

# Wheel and sdist in fresh environments, with all dependencies: about seven minutes.
package: .venv/installed
	$(BIN)/python -m tests.package.full

clean:
	rm -rf .venv .kincal

# The stamp is written last: an installation that broke off is taken up again.
.venv/installed: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@
