# The project's own environment is .venv; two stamps in it say what is installed and how new it is.
PYTHON ?= python3
BIN := .venv/bin
RUNNABLE := .venv/.runnable
TESTABLE := .venv/.testable
# Real grooms are not part of the project: benchmarks that need them say so where they are missing.
GROOMS ?= ../shared/grooms

.PHONY: demo test lint docs bench

demo: $(RUNNABLE)
	@mkdir -p out
	$(BIN)/detangled retexture examples/bob.abc out/bob_coily.abc --target examples/coily_strands.obj
	$(BIN)/detangled render examples/bob.abc out/bob_coily.abc out/bob_coily.png
	@echo "The groom is in out/bob_coily.abc, a picture of it before and after in out/bob_coily.png."

test: $(TESTABLE)
	$(BIN)/python -m pytest

lint: $(TESTABLE)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# The site is read as files; its search needs a server: python -m http.server --directory site
docs: $(TESTABLE)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

bench: $(TESTABLE)
	@failed=; for name in formats head geometry patches fidelity retexture engines network labels controllability guided simulation pipeline density on_head hairs page render; do \
		[ -f benchmarks/$$name.py ] || continue; \
		case $$name in fidelity) strands=$(firstword $(wildcard $(GROOMS)/coily_swatch.obj) examples/coily_strands.obj) ;; *) strands= ;; esac; \
		echo "== benchmarks/$$name.py $$strands"; \
		DETANGLED_GROOMS="$(GROOMS)" $(BIN)/python benchmarks/$$name.py $$strands || failed="$$failed $$name"; \
	done; \
	if [ -n "$$failed" ]; then echo "beyond a bound or failed:$$failed"; exit 1; fi

$(RUNNABLE): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(TESTABLE): requirements-dev.txt $(RUNNABLE)
	$(BIN)/python -m pip install --quiet --requirement requirements-dev.txt
	@touch $@
