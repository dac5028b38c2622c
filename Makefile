# lampest: what a user and a tester type.
#
#   make run       set-up, then two lampreys, with weights that the data choose and with the paper's: table on screen; results, pictures in results/table1/
#   make install   set-up alone: .venv with the command .venv/bin/lampest
#   make test      set-up with what tests need, then the tests that guard behaviour, the board's, and a choice of the rest: some minutes
#   make test-all  all tests: those of `make test`, the others, which carry the mark `slow`, with disturbed readings, and `make rounding`
#                  with slow rows
#   make rounding  golden results again, with readings that are changed by 1e-13 and without NumPy's vector extensions: a minute
#   make quick     the tests that notice most in a minute: laws, golden results, defaults, import, wrong input; golden results once more
#                  with readings that are changed by 1e-13; Python alone
#   make mutants   60 random changes of the package, and which of them no fast test notices: an hour or more
#   make lint      style and types
#   make docs      set-up, then the pages as a site: docs/_build/html/index.html; what they show is run for it
#   make studies  every command of docs/studies, page by page: over an hour; PAGES="bench real" names some. Output: results/studies/
#   make lock      after a change of dependencies: the locks with hashes, from pyproject.toml and constraints.txt
#   make licences  what the dependencies' licences are, as docs/reference/licences.md
#   make audit     known vulnerabilities of everything in the locks
#   make clean     remove .venv, builds and caches; results/ stays

PYTHON ?= python3
VENV = .venv
BIN = $(VENV)/bin
QUIETLY = --quiet --disable-pip-version-check --no-input
LOCKED = $(BIN)/python -m pip install $(QUIETLY) --require-hashes --no-deps --requirement
APT = export DEBIAN_FRONTEND=noninteractive; apt-get update -qq && apt-get install -y -qq --no-install-recommends
OUT = results/table1
# Chosen by the functions that a second of each test file calls, of a record of the fast tests (python -m tests.mutation --guards),
# four variants of each test: laws, defaults and golden results but the longest, then import, wrong input, pressure.
QUICK = --variants 4 tests/laws tests/golden tests/contracts/test_import.py tests/contracts/test_wrong_input.py \
        tests/apps/film/test_pressure.py
PYTEST = $(BIN)/python -m pytest -q
GOLDEN = tests/golden/test_table.py
# A processor without vector extensions, as far as NumPy's instructions are concerned.
PLAIN = NPY_DISABLE_CPU_FEATURES="$$($(BIN)/python -m tests.rounding)"
ROWS = not slow
SPREAD = --numprocesses auto --maxprocesses 4 --dist worksteal

# What Python compiles is kept, whatever the environment says: each command then starts a second sooner.
unexport PYTHONDONTWRITEBYTECODE

install: $(VENV)/.installed

run: install
	@$(BIN)/lampest run configs/lampreys.yaml --out $(OUT)
	@$(BIN)/lampest compare $(OUT)/results.h5 --csv $(OUT)/table.csv
	@$(BIN)/lampest plot $(OUT)/results.h5 --out $(OUT)

test: $(VENV)/.installed-dev board-packages
	@$(PYTEST) $(SPREAD) -m 'not slow'

test-all: test
	@$(PYTEST) $(SPREAD) -m slow --disturbed --deselect $(GOLDEN)
	@$(PYTEST) $(SPREAD) -m 'slow and exact'
	@$(MAKE) --silent --no-print-directory rounding ROWS='slow or not slow'

rounding: $(VENV)/.installed-dev
	@$(PLAIN) $(PYTEST) $(SPREAD) -m '$(ROWS)' --disturbed $(GOLDEN)

quick: $(VENV)/.installed-dev
	@$(PYTEST) $(SPREAD) -m 'not slow and not long' $(QUICK)
	@$(PYTEST) $(SPREAD) -m 'not slow and not long' --disturbed $(GOLDEN)

mutants: $(VENV)/.installed-dev
	@$(BIN)/python -m tests.mutation

lint: $(VENV)/.installed-dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

docs: $(VENV)/.installed-dev
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	@echo docs/_build/html/index.html

studies: $(VENV)/.installed-dev
	@$(BIN)/python -m docs.studies.all_pages $(PAGES)

# Everything that is installed is what the locks say, byte for byte; pyproject.toml and constraints.txt say what they may hold.
lock: $(VENV)/.installed-supply
	@$(BIN)/python -m tests.supply lock

licences: $(VENV)/.installed-supply
	@$(BIN)/python -m tests.supply licences

audit: $(VENV)/.installed-supply
	@$(BIN)/python -m tests.supply audit

$(VENV)/.installed: pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	{ echo "lampest needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	{ test "$$(id -u)" = 0 && command -v apt-get >/dev/null && { $(APT) python3-venv; } >/dev/null; } || \
	{ echo "Python cannot make environments here; install the package python3-venv first" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@$(LOCKED) requirements.lock
	@$(BIN)/python -m pip install $(QUIETLY) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed requirements-dev.lock
	@$(LOCKED) requirements-dev.lock
	@touch $@

$(VENV)/.installed-supply: $(VENV)/.installed pyproject.toml constraints.txt
	@$(BIN)/python -m pip install $(QUIETLY) --constraint constraints.txt --editable '.[supply]'
	@touch $@

# What tests need besides Python: a cross compiler, a simulated microcontroller, a browser and a broker of MQTT.
board-packages:
	@missing=; for tool in gcc make avr-gcc avr-g++ avr-objcopy arm-none-eabi-gcc qemu-system-arm \
	chromium chromedriver; do command -v $$tool >/dev/null || missing=1; done; \
	PATH="$$PATH:/usr/sbin" command -v mosquitto >/dev/null || missing=1; \
	test -d /usr/share/arduino/hardware/arduino/avr/cores/arduino || missing=1; \
	test -f /usr/include/simavr/sim_avr.h && test -f /usr/include/libelf.h || missing=1; \
	if test -n "$$missing"; then \
	packages="$$($(MAKE) --silent --no-print-directory -C firmware packages) chromium chromium-driver mosquitto"; \
	if test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then { $(APT) $$packages; } >/dev/null; \
	else echo "The tests of the board need system packages; install them with: apt-get install $$packages" >&2; fi; fi

clean:
	rm -rf $(VENV) build docs/_build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@$(MAKE) --silent --no-print-directory -C firmware clean

.PHONY: install run test test-all rounding quick mutants lint docs studies lock licences audit board-packages clean
