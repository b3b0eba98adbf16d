# One command per task, the same locally and in automation. PYTHON chooses the interpreter.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
PLUGINS = $(wildcard plugins/*)

# Of the page that `make live` shows.
PORT = 9080
# Further arguments of the demos: make healthbot ARGS=--free-ports
ARGS =
NAMESERVICE ?= localhost:2809
FIGURES ?= build/healthbot
RUNS ?= 100000

# pip would say that there is no matching distribution of some package, and not why.
WANTS_ROS = @$(BIN)/python -c 'import platform, sys; \
  here = (platform.system(), platform.machine()); \
  sys.exit(here != ("Linux", "x86_64") and "this needs ROS 2 from PyPI, which is there for Linux on x86_64, not for %s on %s; make demo and make live do without" % here)'

.DELETE_ON_ERROR:
.PHONY: attack demo live drive healthbot healthbot-tables warehouse mixed plots test test-core test-long coverage changelog matrix lint types docs check bench fuzz mutation wheels smoke interop-rtm clean

demo: $(VENV)/.demo  ## the paper's example on real footage
	$(BIN)/python examples/vision/demo.py $(ARGS)

live: $(VENV)/.live  ## the same chain without an end, with pictures at http://127.0.0.1:$(PORT)/
	$(BIN)/python examples/vision/live.py --port $(PORT) $(ARGS)

drive: $(VENV)/.drive  ## a base that drives while a button is held, and stops whatever dies
	$(BIN)/python examples/drive/drive.py $(ARGS)

healthbot: $(VENV)/.healthbot  ## the paper's case study: every part, and two applications
	$(BIN)/python examples/healthbot/scene.py $(ARGS)

healthbot-tables: $(VENV)/.healthbot  ## the paper's evaluation as tables; takes about eight minutes
	$(BIN)/python examples/healthbot/experiments/every.py --record $(FIGURES)

warehouse: $(VENV)/.warehouse  ## another domain: mobile robots of several frameworks carry boxes
	$(BIN)/python examples/warehouse/warehouse.py $(ARGS)

mixed: $(VENV)/.mixed  ## ROS 1, ROS 2 and MQTT in one application; a camera is killed and comes back
	$(BIN)/python examples/mixed/mixed.py $(ARGS)

plots: $(VENV)/.healthbot  ## plots of the figures that healthbot-tables recorded
	$(BIN)/python -m pip install --quiet -e '.[plots]'
	$(BIN)/python examples/healthbot/experiments/plots.py $(FIGURES)

test: $(VENV)/.dev  ## every test that this machine can run, and a table of what was run
	$(BIN)/python -m tests.tiers

test-core: $(VENV)/.core  ## what needs no framework, no browser and no camera
	$(BIN)/python -m tests.tiers core

test-long: $(VENV)/.dev mutation  ## the rest: properties at length, another order, a soak, mutations
	$(BIN)/python -m tests.tiers long
	$(BIN)/python -m bench.soak --minutes 10

coverage: $(VENV)/.core  ## lines and branches that the core's tests reach
	rm -rf build/coverage; mkdir -p build/coverage
	$(BIN)/python -m coverage run -m pytest -q -n auto -m "not needs and not long" tests
	$(BIN)/python -m coverage combine -q
	$(BIN)/python -m coverage report

changelog: $(VENV)/.core  ## what the fragments in changelog.d add to the list of changes
	$(BIN)/towncrier build --draft --version unreleased

matrix: $(VENV)/.core  ## a part of the core on every other CPython that is here
	.ci/matrix $(ARGS) $(BIN)/python

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# One cache: what a plugin uses of uoarm and of libraries is not analysed again for each.
types: export MYPY_CACHE_DIR = $(abspath .mypy_cache)
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

fuzz: $(VENV)/.dev  ## every decoder under random input, RUNS for each; guided by coverage where atheris installs
	-@$(BIN)/python -m pip install --quiet --only-binary :all: atheris
	$(BIN)/python -m tests.fuzz --runs $(RUNS)

attack: $(VENV)/.dev  ## hostile clients against a server of its own, with a well-behaved one beside them
	$(BIN)/python -m bench.attack

mutation: $(VENV)/.dev  ## mutation tests of the schema checker and the reconciler, sampled
	$(BIN)/python -m pip install --quiet 'mutmut>=3.8' 'pytest<9.2'  # mutmut 3.8 cannot do with 9.2
	$(BIN)/python -m bench.mutation schema --sample 300
	$(BIN)/python -m bench.mutation control --sample 300
	$(BIN)/python -m bench.mutation adapt --sample 200
	$(BIN)/python -m bench.mutation meaning --sample 200

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "$(PYTHON) is too old: choose Python 3.10 or later, make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.demo: pyproject.toml | $(BIN)/python
	@echo "Installing uoarm with its vision packages into $(VENV) (about 200 MB, once) ..."
	$(BIN)/python -m pip install --progress-bar on -e '.[vision-lbph,vision-dlib]'
	@touch $@

$(VENV)/.live: pyproject.toml | $(BIN)/python
	@echo "Installing uoarm with its vision and server packages into $(VENV) (about 210 MB, once) ..."
	$(BIN)/python -m pip install --progress-bar on -e '.[vision-lbph,vision-dlib,server]' -e plugins/uoarm-rosbridge
	@touch $@

$(VENV)/.healthbot: pyproject.toml $(wildcard plugins/*/pyproject.toml) | $(BIN)/python
	$(WANTS_ROS)
	@echo "Installing uoarm, its bridges and the HealthBot's packages into $(VENV) (once) ..."
	$(BIN)/python -m pip install --progress-bar on \
	  -e '.[vision-lbph,vision-dlib,healthbot,server,hosts]' -e 'plugins/uoarm-ros2[jazzy]' \
	  -e plugins/uoarm-rtm -e 'plugins/uoarm-rocos[speech]' -e plugins/uoarm-rosbridge
	@touch $@

$(VENV)/.drive: pyproject.toml $(wildcard plugins/*/pyproject.toml) | $(BIN)/python
	$(WANTS_ROS)
	@echo "Installing uoarm and its bridge to ROS 2 into $(VENV) (once) ..."
	$(BIN)/python -m pip install --progress-bar on -e '.[server,hosts]' \
	  -e 'plugins/uoarm-ros2[jazzy]' -e plugins/uoarm-rosbridge
	@touch $@

$(VENV)/.warehouse: pyproject.toml $(wildcard plugins/*/pyproject.toml) | $(BIN)/python
	$(WANTS_ROS)
	@echo "Installing uoarm and its bridges into $(VENV) (once) ..."
	$(BIN)/python -m pip install --progress-bar on -e '.[server,hosts]' \
	  -e 'plugins/uoarm-ros2[jazzy]' ros-jazzy-test-msgs -e plugins/uoarm-rtm -e plugins/uoarm-mqtt \
	  -e plugins/uoarm-vda5050 -e plugins/uoarm-rocos -e plugins/uoarm-rosbridge
	@touch $@

$(VENV)/.mixed: pyproject.toml $(wildcard plugins/*/pyproject.toml) | $(BIN)/python
	$(WANTS_ROS)
	@echo "Installing uoarm and its bridges to ROS 1, ROS 2 and MQTT into $(VENV) (once) ..."
	$(BIN)/python -m pip install --progress-bar on -e . -e 'plugins/uoarm-ros2[jazzy]' \
	  -e plugins/uoarm-ros1 -e plugins/uoarm-mqtt
	@touch $@

$(VENV)/.core: pyproject.toml | $(BIN)/python
	@echo "Installing uoarm and the test tools into $(VENV) (about 80 MB, once) ..."
	$(BIN)/python -m pip install --quiet -e '.[dev]'
	@touch $@

$(VENV)/.dev: $(VENV)/.core $(wildcard plugins/*/pyproject.toml)
	@echo "Installing what the plugins and the examples need (up to 900 MB, once) ..."
	$(BIN)/python -m tests.tiers --install
	@touch $@

$(VENV)/.build: | $(BIN)/python
	$(BIN)/python -m pip install --quiet 'build>=1.2'
	@touch $@

$(VENV)/.docs: pyproject.toml $(VENV)/.dev
	$(BIN)/python -m pip install --quiet -e '.[docs]'
	@touch $@

wheels: $(VENV)/.build  ## source archives and wheels of everything, in dist; the same tree makes the same files
	.ci/wheels $(BIN)/python dist

smoke: wheels  ## the wheels in an environment of their own, away from the checkout
	.ci/smoke $(BIN)/python dist

interop-rtm: $(VENV)/.dev  ## the OpenRTM plugin against the components at NAMESERVICE
	NAMESERVICE=$(NAMESERVICE) $(BIN)/python -m pytest plugins/uoarm-rtm/tests/interop.py

clean:
	rm -rf $(VENV) build dist .cache .hypothesis .mypy_cache .pytest_cache .ruff_cache demo-output
