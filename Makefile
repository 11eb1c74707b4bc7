# `make run` does everything: sets up .venv, drives the cycles, finds the gain, estimates the maps, writes build/report.html.
# `make help` lists the rest. The files below depend on each other, so changing one log remakes only what follows from it.

PYTHON ?= python3
CONFIG ?= configs/diesel.toml
SEED   ?= 1
BUILD  ?= build

# What does not wait for each other is made side by side, on as many processors as there are.
MAKEFLAGS += --jobs=$(shell $(PYTHON) -c 'import os; print(os.cpu_count())')

VENV   := .venv
LPVOBS := $(VENV)/bin/lpvobs
LOGS   := $(BUILD)/logs
CYCLES := etc ftp75 nedc
JUDGED := etc_part1 ftp75_cold
FAULT  := configs/effects/undeclared_leak.toml
OTHER  := $(BUILD)/other
HEALTHY := etc ftp75 wltc

.DELETE_ON_ERROR:
.SUFFIXES:
.SECONDARY:
.PHONY: help setup run test test-all proofs lint bench blind blind2 thresholds forms wrong as-it-is series fleet-proof unit extrapolation docs defects schemas kill fuzz mutants matrix clean

help:
	@echo 'make run     the whole chain, ends with $(BUILD)/report.html and a result per cycle'
	@echo 'make setup   a virtual environment in $(VENV) with all dependencies'
	@echo 'make test    the tests that take a moment; four minutes on two processors'
	@echo 'make test-all them and the slow ones, which is what CI runs; tests/README.md says which and why'
	@echo 'make proofs  what takes longer than CI has time for, and how each ended; half an hour of one processor'
	@echo 'make lint    ruff and mypy'
	@echo 'make blind   the blind bank: effects drawn at random, for both engines, judged by a process that cannot know them; an hour and a half'
	@echo 'make blind2  the second bank: engines of another structure, effects with other formulas; may be stopped, and goes on; hours for all 360 drives'
	@echo 'make forms   formulas for what no catalogue has, beside PySINDy (SEED of other drives: DRAWN=...); ten minutes of one processor'
	@echo 'make wrong   whether wrong engines and mixed-up logs are noticed, case by case; twenty minutes of one processor'
	@echo 'make thresholds how near decisions come to the tuned numbers, and what half and twice of each changes; under two hours'
	@echo 'make bench   the larger proofs: rivals, wrong constants, coverage, speed, scaling; results in benchmarks/results'
	@echo 'make series  the engine without turbine speed and exhaust pressure beside the full diesel, ten draws, and a bank of its faults; half an hour of one processor'
	@echo 'make fleet-proof a fleet that ages, twenty times: what track finds, whom it accuses, how good its maps are; ten minutes of one processor'
	@echo 'make unit    the observer in C beside Python on every cycle, and what a step costs; needs gcc and valgrind, half an hour'
	@echo 'make extrapolation nodes that nobody drove, on 100 surfaces a cycle, and the bound of the state; forty minutes of one processor'
	@echo 'make kill    SIGKILL at 1000 random moments (NUMBER=...) of every verb that writes'
	@echo 'make fuzz    100 000 damaged and hostile inputs (NUMBER=...), 2000 on the command line (COMMANDS=...)'
	@echo 'make mutants deliberate faults in the core rooms, and whether the tests notice (NUMBER=300)'
	@echo 'make matrix  the tests with the lowest and newest versions, on other Pythons, without the compiler (ROW=lowest TESTS=tests/maps)'
	@echo 'make docs    the documentation as a site in $(BUILD)/docs; a warning is an error'
	@echo 'make defects docs/defects.md, from the tests that hold its rows'
	@echo 'make schemas the JSON Schemas of configuration and --json, in schemas'
	@echo 'make clean   removes $(BUILD)'

# --- set-up ---------------------------------------------------------------------------------------------------------------
setup: $(VENV)/.ready

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed, this is " + sys.version.split()[0] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --no-compile --editable '.[dev]'
	touch $@

$(VENV)/.ready: $(VENV)/.installed
	$(VENV)/bin/lpvobs selftest > /dev/null  # compiles every kernel and module on its way, which no verb waits for then
	touch $@

# --- the chain ------------------------------------------------------------------------------------------------------------
run: $(BUILD)/report.html $(OTHER)/report.html
	@echo 'Look at $(BUILD)/report.html; results: $(JUDGED:%=$(BUILD)/%.h5)'
	@echo 'An engine that is not the model: $(OTHER)/report.html'

CORE       := lpvobs/errors.py lpvobs/records.py
SIMULATION := $(CORE) $(wildcard lpvobs/simulation/*.py lpvobs/simulation/*/*.py data/cycles/*.csv)
SYNTHESIS  := $(CORE) $(wildcard lpvobs/engines/*.py lpvobs/engines/*/*.py lpvobs/synthesis/*.py)
ESTIMATION := $(SYNTHESIS) $(wildcard lpvobs/maps/*.py lpvobs/observer/*.py)
DISCOVERY  := $(wildcard lpvobs/discovery/*.py)
REPORTING  := $(wildcard lpvobs/report/*.* lpvobs/report/templates/*)

$(LOGS)/%.parquet: $(CONFIG) $(SIMULATION) | $(VENV)/.ready
	@mkdir -p $(@D)
	$(LPVOBS) simulate --config $(CONFIG) --cycle $* --seed $(SEED) --out $@

$(LOGS)/%_faulty.parquet: $(CONFIG) $(FAULT) $(SIMULATION) | $(VENV)/.ready
	@mkdir -p $(@D)
	$(LPVOBS) simulate --config $(CONFIG) --cycle $* --seed $(SEED) --effects $(FAULT) --out $@

$(BUILD)/gain.h5: $(CONFIG) $(CYCLES:%=$(LOGS)/%.parquet) $(SYNTHESIS)
	$(LPVOBS) synth-gain --config $(CONFIG) $(CYCLES:%=$(LOGS)/%.parquet) --out $@
	$(LPVOBS) verify $@

$(BUILD)/gain_published.h5: $(CONFIG) $(SYNTHESIS) | $(VENV)/.ready
	@mkdir -p $(@D)
	$(LPVOBS) synth-gain --config $(CONFIG) --published ETC --out $@
	$(LPVOBS) verify $@

$(BUILD)/%_published.h5: $(LOGS)/%.parquet $(BUILD)/gain_published.h5 $(ESTIMATION)
	$(LPVOBS) estimate --config $(CONFIG) --gain $(BUILD)/gain_published.h5 --method published $< --out $@
	$(LPVOBS) extrapolate $@

$(BUILD)/%.h5: $(LOGS)/%.parquet $(BUILD)/gain.h5 $(ESTIMATION)
	$(LPVOBS) estimate --config $(CONFIG) --gain $(BUILD)/gain.h5 $< --out $@
	$(LPVOBS) extrapolate $@

# The loop: a map that knows nothing of the fault, the model with what `refine` finds that it lacks, the error on a drive that nothing was fitted to.
$(BUILD)/refined.h5: $(BUILD)/etc_part1_faulty.h5 $(LOGS)/ftp75_cold_faulty.parquet $(DISCOVERY)
	$(LPVOBS) refine $< $(LOGS)/etc_part1_faulty.parquet --hold-out $(LOGS)/ftp75_cold_faulty.parquet --out $@

RESULTS := $(foreach cycle,$(JUDGED),$(BUILD)/$(cycle).h5 $(BUILD)/$(cycle)_published.h5)

$(BUILD)/report.html: $(RESULTS) $(BUILD)/refined.h5 $(REPORTING)
	$(LPVOBS) report $(RESULTS) $(BUILD)/refined.h5 $(JUDGED:%=$(LOGS)/%.parquet) $(LOGS)/etc_part1_faulty.parquet --html $@

# --- the chain on an engine that is not the model ------------------------------------------------------------------------------
# A displacement and a compressor of its own, and every feature that the model lacks. The tool knows it from a bench table and healthy drives.
$(OTHER)/engine.toml: $(CONFIG)
	@mkdir -p $(@D)
	sed -e 's/^V_d = 1.910e-3/V_d = 1.925e-3/' -e 's/^R_c = 0.0245/R_c = 0.0243/' \
	    -e '/^\[simulation.structure\]/,/^$$/s/= 0.0 /= 1.0 /' $< > $@

$(OTHER)/bench.csv: $(OTHER)/engine.toml $(SIMULATION) | $(VENV)/.ready
	$(LPVOBS) simulate --config $< --bench 100 --out $@

$(OTHER)/engine.h5: $(OTHER)/bench.csv $(SYNTHESIS) $(wildcard lpvobs/calibration/*.py)
	$(LPVOBS) calibrate --config $(CONFIG) --bench $< --out $@

$(OTHER)/%.parquet: $(OTHER)/engine.toml $(SIMULATION) | $(VENV)/.ready
	$(LPVOBS) simulate --config $< --cycle $* --rate 20 --seed $(SEED) --out $@

$(OTHER)/%_faulty.parquet: $(OTHER)/engine.toml $(FAULT) $(SIMULATION) | $(VENV)/.ready
	$(LPVOBS) simulate --config $< --cycle $* --rate 20 --seed $(SEED)0 --effects $(FAULT) --out $@

$(OTHER)/%_later.parquet: $(OTHER)/engine.toml $(SIMULATION) | $(VENV)/.ready
	$(LPVOBS) simulate --config $< --cycle $* --rate 20 --seed $(SEED)1 --out $@

$(OTHER)/heated.parquet: $(OTHER)/etc_part1_later.parquet tools/heated_sensor.py
	$(VENV)/bin/python tools/heated_sensor.py $< $@

$(OTHER)/gain.h5: $(HEALTHY:%=$(OTHER)/%.parquet) $(SYNTHESIS)
	$(LPVOBS) synth-gain --config $(CONFIG) $(HEALTHY:%=$(OTHER)/%.parquet) --out $@

$(OTHER)/map.h5: $(OTHER)/gain.h5 $(OTHER)/engine.h5 $(ESTIMATION) $(DISCOVERY)
	$(LPVOBS) estimate --config $(CONFIG) --gain $< --engine $(OTHER)/engine.h5 $(HEALTHY:%=$(OTHER)/%.parquet) --out $@

# A leak that nobody declared, judged on another drive; and a cause in no catalogue, for which there is a formula.
$(OTHER)/leak.h5: $(OTHER)/map.h5 $(JUDGED:%=$(OTHER)/%_faulty.parquet) $(DISCOVERY)
	$(LPVOBS) refine $< $(OTHER)/etc_part1_faulty.parquet --hold-out $(OTHER)/ftp75_cold_faulty.parquet --out $@

$(OTHER)/heat.h5: $(OTHER)/map.h5 $(OTHER)/heated.parquet $(DISCOVERY)
	$(LPVOBS) refine $< $(OTHER)/heated.parquet --out $@

$(OTHER)/report.html: $(OTHER)/map.h5 $(OTHER)/leak.h5 $(OTHER)/heat.h5 $(REPORTING)
	$(LPVOBS) report $(OTHER)/map.h5 $(OTHER)/leak.h5 $(OTHER)/heat.h5 --html $@

# Workers take whole files, in the order of tests/conftest.py.
PYTEST := $(VENV)/bin/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

# --- checks -----------------------------------------------------------------------------------------------------------------
test: $(VENV)/.ready
	$(PYTEST) -m 'not slow and not proof'

test-all: $(VENV)/.ready
	$(PYTEST) -m 'not proof'

proofs: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/proofs.py

lint: $(VENV)/.installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

blind: export OPENBLAS_NUM_THREADS = 1
blind: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/blind

blind2: export OPENBLAS_NUM_THREADS = 1
blind2: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/blind2 --seed clock --out blind2

thresholds: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/thresholds

bench: export OPENBLAS_NUM_THREADS = 1
bench: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/accuracy.py
	$(VENV)/bin/python benchmarks/surfaces.py
	$(VENV)/bin/python benchmarks/mismatch.py
	$(VENV)/bin/python benchmarks/intervals.py
	$(VENV)/bin/python benchmarks/probabilities.py
	$(VENV)/bin/python benchmarks/speed.py
	$(VENV)/bin/python benchmarks/scaling.py
	$(VENV)/bin/python benchmarks/where.py
	$(VENV)/bin/python benchmarks/known_sensors.py

forms: export OPENBLAS_NUM_THREADS = 1
forms: $(VENV)/.ready
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --target $(BUILD)/rival 'pysindy>=2.0'
	$(VENV)/bin/python benchmarks/forms.py $(or $(DRAWN),dev)

wrong: export OPENBLAS_NUM_THREADS = 1
wrong: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/wrong_engine.py

as-it-is: export OPENBLAS_NUM_THREADS = 1
as-it-is: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/engine_as_it_is.py constants
	$(VENV)/bin/python benchmarks/engine_as_it_is.py slow
	$(VENV)/bin/python benchmarks/engine_as_it_is.py flow
	$(VENV)/bin/python benchmarks/engine_as_it_is.py structure
	$(VENV)/bin/python benchmarks/engine_as_it_is.py healthy

series: export OPENBLAS_NUM_THREADS = 1
series: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/series.py
	$(VENV)/bin/python benchmarks/series_faults.py

fleet-proof: export OPENBLAS_NUM_THREADS = 1
fleet-proof: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/fleet.py $(BUILD)/fleet

unit: export OPENBLAS_NUM_THREADS = 1
unit: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/control_unit

extrapolation: export OPENBLAS_NUM_THREADS = 1
extrapolation: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/extrapolation.py 20 2319573
	$(VENV)/bin/python benchmarks/state_bound.py

mutants: $(VENV)/.ready
	$(VENV)/bin/python benchmarks/mutants --number $(or $(NUMBER),300)

matrix: $(VENV)/.matrix-ready
	$(VENV)/bin/nox $(if $(ROW),-s $(ROW)) $(if $(TESTS),-- $(TESTS))

$(VENV)/.matrix-ready: $(VENV)/.ready
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --editable '.[matrix]'
	touch $@

fuzz: $(VENV)/.ready
	PYTHONPATH=.:tests $(VENV)/bin/python -m robust.fuzz --number $(or $(NUMBER),100000)
	PYTHONPATH=.:tests $(VENV)/bin/python -m robust.fuzz --command-line $(or $(COMMANDS),2000)

kill: export OPENBLAS_NUM_THREADS = 1
kill: $(VENV)/.ready
	PYTHONPATH=.:tests $(VENV)/bin/python -m robust.kill --number $(or $(NUMBER),1000)

defects: $(VENV)/.ready
	PYTHONPATH=.:tests $(VENV)/bin/python -m robust.defects

schemas: $(VENV)/.ready
	$(VENV)/bin/python tools/schemas/make.py

# --- documentation ------------------------------------------------------------------------------------------------------------
docs: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/.docs-ready
	@mkdir -p build
	$(VENV)/bin/python -m typer lpvobs.cli.main utils docs --name lpvobs --title Verbs --output build/verbs.md
	$(VENV)/bin/python tools/equations.py > build/equations.md
	$(VENV)/bin/python tools/notebook.py examples/notebook.ipynb > build/notebook.md
	$(VENV)/bin/mkdocs build --strict --site-dir $(BUILD)/docs
	@echo 'Look at $(BUILD)/docs/index.html'

$(VENV)/.docs-ready: $(VENV)/.ready
	$(VENV)/bin/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

clean:
	rm -rf $(BUILD)
