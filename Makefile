# Everything that a developer starts. `make` alone says what there is.

PYTHON ?= python3
VENV := .venv
RUN := $(VENV)/bin/python

# A sourced ROS installation or another environment must not leak into this one. LD_LIBRARY_PATH
# is left alone unless it comes from such a ROS installation: some Pythons need it to start.
ifdef AMENT_PREFIX_PATH
unexport LD_LIBRARY_PATH
endif
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
unexport PYTHONHOME PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE

# Containers often set it. Each of the processes that tests start would compile what it imports.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help env env-lint env-docs lock test test-slow coverage fuzz lint demo rates docs images clean

help:
	@echo 'make demo        play a recorded drive into the node over DDS, draw what it finds'
	@echo 'make test        the fast tests; those of one folder: make test ROOM=pipeline/soil'
	@echo 'make test-slow   the slow tests: Monte Carlo, soak, long drives, random examples'
	@echo 'make fuzz        hostile inputs: 10^5 of them, MINUTES=2 for each way in'
	@echo 'make coverage    the fast tests once more, and which lines they did not reach'
	@echo 'make lint        ruff and mypy'
	@echo 'make rates       rates over worlds, real drives (DRIVES=FOLDERS), and speed against peers; both pages'
	@echo 'make docs        the documentation as a site, docs/_build/html'
	@echo 'make images      drawings and pictures of docs/images anew (some: make images IMAGES="learnt.png")'
	@echo 'make env         only make the environment $(VENV) (the others do it when needed)'
	@echo 'make lock        pin the packages of the environment anew, with hashes (needs uv)'
	@echo 'make clean       remove everything that make has made'
	@echo 'Another Python:  make PYTHON=python3.12 test      (3.10 to 3.13; default: $(PYTHON))'
	@echo 'Some tests:      make test PYTEST_ADDOPTS="-k sinkage -x"'

# env-lint, env-docs: with what `make lint`, `make docs` need besides.
env env-lint env-docs:
	@command -v $(PYTHON) >/dev/null || { echo 'smallwheel_ros: no $(PYTHON) found: install Python 3.10 to 3.13, or name one with make PYTHON=...' >&2; exit 1; }
	@$(PYTHON) tools/environment.py $(if $(filter file,$(origin PYTHON)),--keep-python) $(patsubst env%,-%,$(filter-out env,$@))

# The headers stay, and so do versions that still suit. What lint and docs have in common with the environment has the
# same versions.
COMPILE := uv pip compile --quiet --universal --python-version 3.10 --fork-strategy fewest --no-annotate --no-header --generate-hashes
lock:
	@set -e; pin() { name=tools/$$1.lock; shift; cp $$name $$name.new; $(COMPILE) "$$@" --output-file $$name.new; \
	    { grep '^#' $$name; cat $$name.new; } > $$name.whole; mv $$name.whole $$name; rm $$name.new; }; \
	pin environment --extra parquet --extra test pyproject.toml tools/environment.in; \
	for more in lint docs; do pin $$more --constraint tools/environment.lock tools/$$more.in; done

# Three workers, each with whole modules; those of the node on one of them, which mostly waits, and the
# others give way to it (see test/conftest.py). ROOM: a folder of smallwheel_ros/, whose tests are in that of test/.
# Workers, and threads of linear algebra in each, would stand in each other's way: one thread each.
test coverage: export OPENBLAS_NUM_THREADS := 1
test: env
	@$(RUN) -m pytest -m "not slow" $(if $(ROOM),test/$(ROOM),-n 3 --dist loadfile)

# All of them, one after the other: some measure speed and memory. The last line says how long it took.
test-slow: env
	@$(RUN) -m pytest -m "slow or hypothesis" --hypothesis-profile=free --durations=20

# Of this process and of those that the tests start (each writes a file of its own).
coverage: env
	@$(RUN) -m coverage run -m pytest -m "not slow" -n 3 --dist loadfile
	@$(RUN) -m coverage combine -q && $(RUN) -m coverage report --skip-covered

MINUTES ?= 2
fuzz: env
	@OPENBLAS_NUM_THREADS=1 $(RUN) -m fuzz --minutes $(MINUTES)

lint: env-lint
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy --strict smallwheel_ros

demo: env
	@$(VENV)/bin/smallwheel demo

# Rates go on where they were; DRIVES are folders of real drives. A rate beyond its limit is no error here:
# docs/rates.md says which. What each part takes is said before it starts.
DRIVES ?= examples/data
SPEED := speed node twist
rates: env
	@echo 'rates:'; $(RUN) -m rates --list
	@echo 'real drives: 1 min each; speed against peers: $(SPEED), 10 min'
	@$(RUN) -m rates.real_drives $(DRIVES) --page docs/real_robots.md
	-@$(RUN) -m rates
	@set -e; for name in $(SPEED); do echo "== $$name"; $(RUN) -m rates.$$name; done

# A warning is an error. The pages need no network to be made or read.
docs: env-docs
	@$(RUN) -m sphinx -W --keep-going -q -j auto docs docs/_build/html
	@echo 'docs/_build/html/index.html'

# Drawings, and pictures of results, each by the command that its page names.
IMAGES ?=
images: env
	@PYTHONPATH=. $(RUN) docs/drawings/draw.py
	@PYTHONPATH=. $(RUN) docs/drawings/pictures.py $(IMAGES)

clean:
	rm -rf docs/_build docs/_api .coverage* $(VENV) build install log out .pytest_cache .mypy_cache .ruff_cache .hypothesis
