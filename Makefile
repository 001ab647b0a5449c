# `make demo` and `make test` do all the set-up on a fresh machine; run again, the set-up takes no time.

PYTHON := .venv/bin/python

.PHONY: help setup demo test lint types clean

help:
	@echo "make demo   flatten the example photo into out/"
	@echo "make test   lint, types, tests"
	@echo "make setup  only make .venv, with everything in it"
	@echo "make clean  remove .venv and caches"

setup:
	@bash tools/setup.sh

demo: setup
	.venv/bin/hybrid rectify hybrid/examples/film.jpg -o out

lint: setup
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

types: setup
	$(PYTHON) -m pyright

# Two workers share the tests, so the libraries in each get one thread.
test: lint types
	OMP_NUM_THREADS=1 $(PYTHON) -m pytest -n 2

clean:
	rm -rf .venv .pytest_cache .ruff_cache .hypothesis hybrid.egg-info
