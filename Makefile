# `make run` and `make test` are each enough on a machine with git, make and Python 3.11 or later.
# `make test` takes minutes, `make test-all` is what CI runs, `make claims` takes hours and writes the
# numbers that README quotes. `make docs` builds the site.
# ARGS goes to the command: make run ARGS="experiment=NAME", make test ARGS="-k name".

VENV ?= .venv
# The first of these that runs, is recent enough and can make an environment is used.
PYTHON ?= python3 python3.13 python3.12 python3.11 python
UV ?= uv
ARGS ?=

BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DOCS_STAMP := $(VENV)/.docs
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-input
USABLE := import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))

.PHONY: run test test-all claims lint docs docs-all constraints clean

run: $(STAMP)
	@$(BIN)/srsinv $(ARGS)

test: $(STAMP)
	@$(BIN)/python -m pytest $(ARGS)

# The first tier with every annotation checked, and the second, whatever became of the first. pytest
# ends with 5 where ARGS names no test of a tier: one of both may.
test-all: $(STAMP)
	@$(BIN)/python -m pytest --types $(ARGS); first=$$?; \
	$(BIN)/python -m pytest -m "full and not claim" $(ARGS); second=$$?; \
	case $$first$$second in 00|05|50) ;; *) exit 1 ;; esac

claims: $(STAMP)
	@$(BIN)/python -m pytest -m claim $(ARGS)
	@$(BIN)/python -m tests.claims

# The wrapper of pyright would otherwise speak of newer versions than the pinned one.
lint: $(STAMP)
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@PYRIGHT_PYTHON_IGNORE_WARNINGS=1 $(BIN)/pyright --pythonpath $(BIN)/python

# The site from stored outputs, in docs/_build/html.
docs: $(DOCS_STAMP)
	@$(BIN)/python -m sphinx -q -E -W --keep-going -j 2 -d docs/_build/doctrees docs docs/_build/html
	@echo "docs/_build/html/index.html"

# The same from nothing: every experiment of the gallery and every page is executed first.
docs-all: $(DOCS_STAMP)
	@$(BIN)/python -m docs.tools.gallery
	@$(BIN)/python -m docs.tools.execute
	@$(MAKE) --no-print-directory docs

COMPILE := pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes \
	--no-emit-index-url --no-annotate --no-header --quiet --upgrade

constraints:
	$(UV) $(COMPILE) --extra test --extra dev --output-file constraints.txt
	$(UV) $(COMPILE) --extra docs --constraint constraints.txt --output-file docs/constraints.txt

clean:
	rm -rf $(VENV) build dist docs/_build .pytest_cache .ruff_cache .hypothesis

# Everything is pinned with hashes, also what builds the one package without a wheel; no other is
# built. pip takes no editable install together with hashes, so the project comes last and alone.
$(STAMP): constraints.txt build-constraints.txt pyproject.toml
	@test -x $(BIN)/pip || { \
		for python in $(PYTHON); do \
			"$$python" -c '$(USABLE)' 2>/dev/null && break; python=; \
		done; \
		test -n "$$python" || { \
			echo "srsinv needs Python 3.11 or later with venv; none of '$(PYTHON)' is one:" \
				"name one with make PYTHON=/path/to/python" >&2; exit 1; }; \
		echo "making $(VENV) with $$("$$python" --version)"; \
		"$$python" -m venv $(VENV); }
	@echo "installing the pinned dependencies into $(VENV) (a minute or two at first)"
	@$(PIP) --require-hashes --only-binary :all: -r build-constraints.txt
	@$(PIP) --require-hashes --only-binary :all: --no-binary antlr4-python3-runtime \
		--no-build-isolation --use-pep517 -r constraints.txt
	@$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

$(DOCS_STAMP): docs/constraints.txt $(STAMP)
	@echo "installing what builds the documentation"
	@$(PIP) --require-hashes --only-binary :all: -r docs/constraints.txt
	@touch $@
