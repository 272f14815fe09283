# Needs make and Python 3.11 or newer, nothing else.

PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo $$p && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
PIP_INSTALL := $(BIN)/python -m pip --disable-pip-version-check install --quiet
PYTEST_ARGS ?=

.DEFAULT_GOAL := help
.PHONY: help install install-dev demo test check format spec lock clean

help:
	@echo 'make demo      install, then show a leader and a follower on a small synthetic walk'
	@echo 'make test      install with the tools, then run the tests (PYTEST_ARGS="-k name" for some of them)'
	@echo 'make check     ruff, mypy, import-linter'
	@echo 'make format    let ruff rewrite the code'
	@echo 'make spec      write docs/openapi.json, docs/asyncapi.json and the tables of the docs anew from the code'
	@echo 'make install   the command pairnavi in $(VENV), exactly the locked versions'
	@echo 'make lock      write requirements/*.txt anew from pyproject.toml (UPGRADE=1 takes newer versions)'
	@echo 'make clean     remove $(VENV) and the caches'

install: $(VENV)/.runtime
install-dev: $(VENV)/.dev

demo: install
	$(BIN)/pairnavi demo

test: install-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS)

check: install-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

spec: install-dev
	$(BIN)/pairnavi spec openapi --out docs/openapi.json
	$(BIN)/pairnavi spec asyncapi --out docs/asyncapi.json
	$(BIN)/python docs/generate.py

# The build tools come locked too: an isolated build would fetch whatever is newest.
$(VENV)/.runtime: $(VENV)/.created requirements/build.txt requirements/runtime.txt pyproject.toml
	@echo 'installing the locked requirements into $(VENV)'
	@$(PIP_INSTALL) --require-hashes -r requirements/build.txt -r requirements/runtime.txt
	@$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.created requirements/build.txt requirements/dev.txt pyproject.toml
	@echo 'installing the locked requirements and the tools into $(VENV)'
	@$(PIP_INSTALL) --require-hashes -r requirements/build.txt -r requirements/dev.txt
	@$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@touch $@ $(VENV)/.runtime

$(VENV)/.created:
	@if test -z '$(PYTHON)' || ! $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then \
		echo 'pairnavi needs Python 3.11 or newer: install it, or name it with make PYTHON=/path/to/python3' >&2; \
		exit 1; fi
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
		echo '$(PYTHON) cannot make virtual environments: install its venv module (Debian: python3-venv)' >&2; \
		exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

LOCK = $(BIN)/uv pip compile --quiet --universal --generate-hashes --python-version 3.11 \
	--custom-compile-command 'make lock' $(if $(UPGRADE),--upgrade)

lock: install-dev
	$(LOCK) pyproject.toml -o requirements/runtime.txt
	$(LOCK) pyproject.toml --extra postgres -c requirements/runtime.txt -o requirements/postgres.txt
	$(LOCK) pyproject.toml --extra dev -c requirements/runtime.txt -o requirements/dev.txt
	$(LOCK) requirements/build.in -c requirements/dev.txt -o requirements/build.txt

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
