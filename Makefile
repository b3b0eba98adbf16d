# One command per task, the same locally and in automation. PYTHON chooses the interpreter.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
PLUGINS = $(wildcard plugins/*)

NAMESERVICE ?= localhost:2809
FIGURES ?= build/healthbot

# pip would say that there is no matching distribution of some package, and not why.
WANTS_ROS = @$(BIN)/python -c 'import platform, sys; \
  here = (platform.system(), platform.machine()); \
  sys.exit(here != ("Linux", "x86_64") and "this needs ROS 2 from PyPI, which is there for Linux on x86_64, not for %s on %s; make demo and make live do without" % here)'

.DELETE_ON_ERROR:
.PHONY: demo live healthbot healthbot-tables plots test test-long lint types docs check bench mutation interop-rtm clean

demo: $(VENV)/.demo  ## the paper's example on real footage
	$(BIN)/python examples/vision/demo.py

live: $(VENV)/.live  ## the same chain without an end, with pictures at http://127.0.0.1:9080/
	$(BIN)/python examples/vision/live.py

healthbot: $(VENV)/.healthbot  ## the paper's case study: every part, and two applications
	$(BIN)/python examples/healthbot/scene.py

healthbot-tables: $(VENV)/.healthbot  ## the paper's evaluation as tables; takes about eight minutes
	$(BIN)/python examples/healthbot/experiments/every.py --record $(FIGURES)

plots: $(VENV)/.healthbot  ## plots of the figures that healthbot-tables recorded
	$(BIN)/python -m pip install --quiet -e '.[plots]'
	$(BIN)/python examples/healthbot/experiments/plots.py $(FIGURES)

test: $(VENV)/.dev  ## every test
	$(BIN)/python -m pytest -n 2 tests
	@for plugin in $(PLUGINS); do \
	  echo "== $$plugin"; $(BIN)/python -m pytest -c pyproject.toml --rootdir=. $$plugin/tests || exit 1; \
	done

test-long: $(VENV)/.dev  ## the property tests with their long profile
	HYPOTHESIS_PROFILE=long $(BIN)/python -m pytest -n 2 tests

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev
	$(BIN)/mypy
	@for plugin in $(PLUGINS); do \
	  echo "== $$plugin"; (cd $$plugin && $(abspath $(BIN))/mypy) || exit 1; \
	done

docs: $(VENV)/.docs  ## the documentation site, in build/docs; every warning is an error
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs

check: lint types test  ## everything that must be green

bench: $(VENV)/.dev  ## tables of medians and p99
	$(BIN)/python -m bench

mutation: $(VENV)/.dev  ## mutation tests of the schema checker, sampled
	$(BIN)/python -m pip install --quiet 'mutmut>=3.8'
	$(BIN)/python bench/mutation.py --sample 300

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "$(PYTHON) is too old: choose Python 3.10 or later, make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.demo: pyproject.toml | $(BIN)/python
	@echo "Installing uoarm with its vision packages into $(VENV) (about 200 MB, once) ..."
	$(BIN)/python -m pip install --progress-bar on -e '.[vision,vision-dlib]'
	@touch $@

$(VENV)/.live: pyproject.toml | $(BIN)/python
	@echo "Installing uoarm with its vision and server packages into $(VENV) (about 210 MB, once) ..."
	$(BIN)/python -m pip install --progress-bar on -e '.[vision,vision-dlib,server]'
	@touch $@

$(VENV)/.healthbot: pyproject.toml $(wildcard plugins/*/pyproject.toml) | $(BIN)/python
	$(WANTS_ROS)
	@echo "Installing uoarm, its bridges and the HealthBot's packages into $(VENV) (once) ..."
	$(BIN)/python -m pip install --progress-bar on \
	  -e '.[vision,vision-dlib,healthbot,server,hosts]' -e 'plugins/uoarm-ros2[jazzy]' \
	  -e plugins/uoarm-rtm -e 'plugins/uoarm-rocos[speech]'
	@touch $@

$(VENV)/.dev: pyproject.toml $(wildcard plugins/*/pyproject.toml) | $(BIN)/python
	$(WANTS_ROS)
	@echo "Installing uoarm, its plugins and the test tools into $(VENV) (about 900 MB, once) ..."
	$(BIN)/python -m pip install --quiet -e '.[dev,vision,vision-dlib,healthbot]' \
	  $(foreach plugin,$(PLUGINS),-e '$(plugin)[dev]')
	@touch $@

$(VENV)/.docs: pyproject.toml $(VENV)/.dev
	$(BIN)/python -m pip install --quiet -e '.[docs]'
	@touch $@

interop-rtm: $(VENV)/.dev  ## the OpenRTM plugin against the components at NAMESERVICE
	NAMESERVICE=$(NAMESERVICE) $(BIN)/python -m pytest plugins/uoarm-rtm/tests/interop.py

clean:
	rm -rf $(VENV) build .cache .hypothesis .mypy_cache .pytest_cache .ruff_cache demo-output
