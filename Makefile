# make test and make demo each create what they need: a .venv from pinned, hashed requirements.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready

.PHONY: test bench demo pictures lint types imports check lock clean

test: $(READY)
	$(BIN)/python -m pytest --cov --cov-report=term

bench: $(READY)
	$(BIN)/python benchmarks/verification.py

demo: $(READY)
	$(BIN)/cutgate demo

pictures: $(READY)
	$(BIN)/python docs/make_pictures.py

check: lint types imports

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

imports: $(READY)
	$(BIN)/lint-imports

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: --require-hashes -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --no-index -e .
	touch $@

# Rewrites requirements.txt from pyproject.toml; it names versions and hashes, never an address.
lock: $(READY)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
		--no-emit-find-links --no-header --no-annotate --extra dev pyproject.toml -o requirements.txt

clean:
	rm -rf .venv build *.egg-info
