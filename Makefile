# make test and make demo each create what they need: an environment from pinned, hashed requirements.
# PYTHON=python3.13 VENV=.venv-3.13 does it beside the usual one with another Python.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
# The index is the user's own, a mirror perhaps; nothing else of pip's settings may change what is installed or where.
PIP := env -u PIP_TARGET -u PIP_PREFIX -u PIP_ROOT -u PIP_REQUIRE_VIRTUALENV PIP_CONSTRAINT=/dev/null PIP_USER=0 \
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps

.PHONY: test test-all test-slow coverage test-long test-vcan fuzz c-sources bench demo pictures lint types imports check install lock wheel clean docs coverage-own mutation

# In minutes: what needs the processor on every core, then what starts processes, each test on a bus of its own. Those
# mostly wait: two more at a time than two cores would take otherwise.
PYTEST := $(BIN)/python -m pytest --quiet
BY_FILE := --dist loadfile --no-loadscope-reorder
AT_ONCE ?= 4
# The tests start many interpreters: none of them needs to compile everything anew, whatever the environment says.
unexport PYTHONDONTWRITEBYTECODE
test: $(READY)
	$(PYTEST) $(BY_FILE) --numprocesses auto -m "not processes and not slow and not long$(if $(BRIEF), and not no_cover)" $(if $(BRIEF),$(BRIEFLY))
	$(PYTEST) --dist worksteal --numprocesses $(AT_ONCE) -m "processes and not slow and not long and not browser" --ignore tests/vcan \
		$(if $(BRIEF),--ignore tests/firmware_sim/hil/test_plugin.py)
	$(if $(BRIEF),,$(PYTEST) -m "browser and not slow and not long" tests/browser)

# A browser draws in software on every core and writes its profile: sessions beside it would wait for processor and disk.
# With BRIEF=1, on a second Python, it is left out, and what repeats one act hundreds of times, and whole sessions in virtual
# time with every error and fault and the worlds of the exploration, which are the same on any; pages; and tests of tests.
BRIEFLY := $(addprefix --ignore tests/,errors exploration fault_injection docs mutation)

# All that make test leaves out for its time: branch coverage, as a whole and of each deciding module by its own tests,
# a sample of mutants, larger worlds, the packages' index, the wheel, real SocketCAN.
test-all: $(READY) coverage coverage-own test-slow test-vcan

# Of what runs in one process, but for what repeats one act hundreds of times; a report of nothing is not a whole one.
STATEMENTS_MIN := 26000
coverage: $(READY)
	$(PYTEST) $(BY_FILE) --numprocesses auto -m "not processes and not slow and not long and not no_cover" \
		--cov --cov-report=term --cov-report=json:.coverage.json
	$(BIN)/python tools/coverage_whole.py .coverage.json $(STATEMENTS_MIN)

test-slow: $(READY)
	$(PYTEST) $(BY_FILE) --numprocesses auto -m "slow and not long" --ignore tests/vcan

# A million random segments against the dense reference on all cores, 10 000 plans cut by the simulated arm, 2000 runs of fault
# injection over both loops, a campaign of 10 000 scenarios, an hour of cutting under what is tolerated, every mistake in the
# tables, the large worlds of the exploration (3.3 GB), a log cut at every byte; CUTGATE_SEGMENTS, CUTGATE_FAULT_RUNS and
# CUTGATE_SEED change how many segments and runs, and which.
test-long: $(READY)
	$(BIN)/python -m pytest -m long -s --timeout=0 -p no:cacheprovider tests/runtime/verification tests/fault_injection tests/exploration \
		tests/firmware_sim tests/runtime/audit tests/system/test_kill_anywhere.py

# Whole sessions on real SocketCAN; where the kernel has no vcan0, in a small virtual machine (docs/bus.md).
test-vcan: $(READY)
	tools/vcan.sh $(BIN)/python

# Coverage-guided search for bytes that break a parser's promise; FAMILIES and SECONDS (of each) change it.
FAMILIES ?= frames transfers records files stored certificate bus terminal audit
SECONDS ?= 20
fuzz: .venv-fuzz/ready
	set -e; for family in $(FAMILIES); do echo "== $$family"; \
		.venv-fuzz/bin/python -m tools.fuzz.search $$family -max_total_time=$(SECONDS) -print_final_stats=1; done

# atheris has no place among the pinned packages: nothing but this target needs it.
.venv-fuzz/ready: requirements-dev.txt pyproject.toml
	$(PYTHON) -m venv --clear .venv-fuzz
	$(MAKE) --no-print-directory VENV=.venv-fuzz install
	.venv-fuzz/bin/python -m pip install --quiet --disable-pip-version-check --only-binary :all: "atheris>=3,<4"
	touch $@

# C sources of the single frames, from the DBC: cutgate.c and cutgate.h in OUT.
OUT ?= build/c
c-sources: $(READY)
	mkdir -p $(OUT)
	$(BIN)/cantools generate_c_source --use-round protocol/cutgate.dbc -o $(OUT)

# Each deciding module reached to the last branch by its own tests alone.
coverage-own: $(READY)
	$(BIN)/python -m tools.mutation.modules

# Tests of the tests, some minutes; fails unless tools/mutation/survivors.toml lists exactly what lives.
# MODULES, SAMPLE, CHANGED and JOBS make it less or slower; RECORD=1 records the figures and writes docs/mutation.md.
mutation: $(READY)
	$(BIN)/python -m tools.mutation.run $(if $(JOBS),--jobs $(JOBS)) $(if $(SAMPLE),--sample $(SAMPLE)) \
		$(if $(CHANGED),--changed) $(if $(RECORD),--record) $(MODULES)

# Prints the tables; make bench WRITE=docs/benchmarks.md writes them there as well, the wire's, the bus's, the tool paths' and the signed logs' beside it.
bench: $(READY)
	$(BIN)/python tools/benchmarks/verification.py $(if $(WRITE),--write $(WRITE))
	$(BIN)/python tools/benchmarks/wire.py $(if $(WRITE),--write $(WRITE:.md=-wire.md))
	$(BIN)/python tools/benchmarks/bus.py $(if $(WRITE),--write $(WRITE:.md=-bus.md))
	$(BIN)/python tools/benchmarks/tool_paths.py $(if $(WRITE),--write $(WRITE:.md=-tool-paths.md))
	$(BIN)/python tools/benchmarks/audit.py $(if $(WRITE),--write $(WRITE:.md=-audit.md))

demo: $(READY)
	$(BIN)/cutgate demo

# What is generated from the code: constants, state machines, error matrix, what comes back of cut logs, attacks on logs, pictures.
docs: $(READY) pictures
	$(BIN)/python -m cutgate.config.constants > docs/constants.md
	$(BIN)/python -m docs.make_state_machines
	$(BIN)/python -m docs.make_transitions
	$(BIN)/python -m docs.make_error_matrix
	$(BIN)/python -m docs.make_recovery
	$(BIN)/python -m docs.make_attacks
	$(BIN)/python -m docs.make_screens
	$(BIN)/python -m docs.make_environments

pictures: $(READY)
	$(BIN)/python docs/make_pictures.py
	$(BIN)/python -m docs.make_reports

check: lint types imports

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

imports: $(READY)
	$(BIN)/lint-imports

$(READY): requirements-dev.txt pyproject.toml
	$(PYTHON) -m venv --clear $(VENV)
	$(MAKE) --no-print-directory install
	touch $@

# Everything is locked and nothing is resolved here: what is released tomorrow changes nothing.
install:
	$(PIP) --only-binary :all: --require-hashes -r requirements-dev.txt
	$(PIP) --no-build-isolation --no-index --editable .

# Rewrites both locks from pyproject.toml, keeping what fits; they name versions and hashes, never an address.
# requirements.txt is what runs beside a controller, requirements-dev.txt all of it with pictures, HDF5 and development.
COMPILE := pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	--no-emit-find-links --no-header --no-annotate pyproject.toml
lock: $(VENV)-lock/ready
	$(VENV)-lock/bin/uv $(COMPILE) --output-file requirements.txt
	$(VENV)-lock/bin/uv $(COMPILE) --constraint requirements.txt --extra pictures --extra h5 --extra dev \
		--output-file requirements-dev.txt

$(VENV)-lock/ready:
	$(PYTHON) -m venv --clear $(VENV)-lock
	$(VENV)-lock/bin/python -m pip install --quiet --disable-pip-version-check "uv==0.13.9"
	touch $@

# The product as it is installed elsewhere.
wheel: $(READY)
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --no-index \
		--wheel-dir dist .

clean:
	rm -rf .venv .venv-* build dist *.egg-info
