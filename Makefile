# Dexterous grasping suite. `make help` lists the targets.
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3        # 3.11, or 3.12 (pybullet is compiled there, some minutes)
TORCH_INDEX ?=           # package index to take torch from, e.g. PyTorch's CPU-only one, to avoid gigabytes of GPU libraries
SEED ?= 0
OBJECTS ?= 5
HAND ?=                  # which hand all processes have: dexhand_pro (default), dexhand_021, a folder ./my_hand
VIEW ?=                  # not empty: the demo serves its live page
OUT ?=                   # run folder of the demo or the evaluation
SCENES ?=                # scenes per run: 60 in the evaluation (paper: 240), 25 in the series
FAST ?=                  # not empty: leave the slow tests out
MINUTES ?=               # of the soak: 60
JOBS ?=                  # processes of the tests; one more than cores (at most 6) if empty: nodes under test often wait
ARGS ?=                  # further arguments of demo.sh, pytest, dgs bench-inference, dgs evaluate, dgs experiment
# A comment behind a value leaves blanks in it.
PYTHON := $(strip $(PYTHON))
TORCH_INDEX := $(strip $(TORCH_INDEX))
OUT := $(strip $(OUT))
VIEW := $(strip $(VIEW))
SCENES := $(strip $(SCENES))
FAST := $(strip $(FAST))
JOBS := $(strip $(JOBS))
export SEED OBJECTS OUT VIEW
ifneq ($(strip $(HAND)),)
export DGS_HAND := $(strip $(HAND))
endif

VENV := .venv
IN_ENV := source ros2_ws/setup_env.sh &&
MODE := $(shell source ros2_ws/tools/ros_mode.sh && echo $$dgs_ros_mode)

# With an installed ROS 2, the virtual environment sees the system's Python packages and ROS is not fetched again; the
# message packages are compiled for the numpy that it gets. Else numpy comes with ROS, and the build needs nothing more.
REQUIREMENTS := requirements/runtime.txt requirements/dev.txt
ifeq ($(MODE),installed)
VENV_FLAGS := --system-site-packages
ROS_REQUIREMENTS :=
CONSTRAINTS :=
BUILD_NEEDS := $(VENV)/.requirements
else
VENV_FLAGS :=
ROS_REQUIREMENTS := requirements/ros.txt requirements/build.txt
CONSTRAINTS := -c requirements/constraints.txt
BUILD_NEEDS := $(VENV)/.ros
endif

# What needs a new build when it changes: interfaces, manifests, and a file that comes or goes in a data folder.
# Python modules, launch files, parameters and scripts are linked: their edits take effect at once.
WORKSPACE_FILES := $(shell find -L ros2_ws/src ros2_ws/underlay \
  \( -path '*/msg/*' -o -path '*/srv/*' -o -path '*/action/*' -o -name package.xml -o -name CMakeLists.txt \
  -o -name 'setup.*' \) -type f -print -o -type d -name __pycache__ -prune -o -type d \
  \( -path '*/dgs_bringup/launch*' -o -path '*/dgs_bringup/config*' -o -path '*/dgs_bringup/scripts*' \
  -o -path '*/dgs_description/urdf*' \) -print) ros2_ws/build.sh ros2_ws/tools/ros_mode.sh ros2_ws/cmake/fix_imported_includes.cmake

.PHONY: help setup build demo series test soak audit lint bench evaluate docs constraints clean

help: ## list the targets
	@grep -hE '^[a-z]+:.*##' Makefile | sed -E 's/^([a-z]+):.*## /  make \1\t/' | expand -t 20
	@echo "variables: PYTHON, TORCH_INDEX (setup); SEED, OBJECTS, OUT, HAND, VIEW (demo); FAST, JOBS (test); MINUTES (soak); ARGS (demo, test, bench, series, evaluate); SCENES (series, evaluate)"

setup: $(VENV)/.ros ## virtual environment, requirements, underlay and workspace; quick when all is there
	@$(MAKE) --silent --jobs=2 $(VENV)/.requirements ros2_ws/install/.built

$(VENV)/.ros: $(ROS_REQUIREMENTS) requirements/constraints.txt
	@bash ros2_ws/tools/check_system.sh "$(PYTHON)"
	@if [[ ! -x $(VENV)/bin/pip ]]; then echo "creating $(VENV)"; "$(PYTHON)" -m venv $(VENV_FLAGS) $(VENV); fi
	@$(VENV)/bin/python -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12)))' || \
	  { echo "$(VENV) is of another Python; remove it: make clean && rm -r $(VENV)" >&2; exit 1; }
	@echo "installing the requirements (some minutes the first time)"
	@$(if $(ROS_REQUIREMENTS),$(VENV)/bin/python -m pip install --quiet $(CONSTRAINTS) $(addprefix -r ,$(ROS_REQUIREMENTS)))
	@touch $@

$(VENV)/.requirements: $(VENV)/.ros $(REQUIREMENTS) ros2_ws/tools/link_sources.py
	@if [[ -n "$(TORCH_INDEX)" ]]; then \
	  $(VENV)/bin/python -m pip install --quiet --index-url "$(TORCH_INDEX)" \
	    "$$(grep '^torch==' requirements/runtime.txt)"; fi
	@$(VENV)/bin/python -m pip install --quiet $(CONSTRAINTS) $(addprefix -r ,$(REQUIREMENTS))
	@$(VENV)/bin/python ros2_ws/tools/link_sources.py
	@touch $@

ros2_ws/install/.built: $(BUILD_NEEDS) $(WORKSPACE_FILES)
	@echo "building the workspace"
	@bash ros2_ws/build.sh

build: $(VENV)/.requirements ## build the workspace even if nothing seems to have changed
	@bash ros2_ws/build.sh

demo: setup ## clear a table in the headless simulation: make demo SEED=0 OBJECTS=5 OUT=folder HAND=dexhand_021 VIEW=1
	@$(IN_ENV) bash ros2_ws/src/dgs_bringup/scripts/demo.sh $(ARGS)

series: setup ## the robot protocol: SCENES (25) tables cleared by the whole suite in simulation; goes on where it stopped
	@$(IN_ENV) dgs evaluate --arm --scenes $(or $(SCENES),25) --seed $(SEED) --out "$(or $(OUT),runs/robot)" $(ARGS)

test: setup ## run the tests: make test ARGS="-k planner", make test FAST=1, make test JOBS=1
	@$(IN_ENV) trap 'python -m dgs_ros.shared_memory' EXIT; python -m pytest -n $(or $(JOBS),$(shell n=$$(nproc); echo $$((n < 6 ? n + 1 : 6)))) \
	  --dist loadfile --no-loadscope-reorder --max-worker-restart 0 $(if $(FAST),-m "not slow") $(ARGS)

soak: setup ## fuzz with 500 cases of every property, then the whole suite with faults, restarts and hostile calls: make soak MINUTES=60
	@$(IN_ENV) DGS_FUZZ_CASES=500 python -m pytest -q tests/fuzz
	@$(IN_ENV) python -m pytest -q tests/memory_of_the_planner.py tests/restarts_of_nodes.py
	@$(IN_ENV) python -m tests.soak --minutes $(or $(MINUTES),60) --seed $(SEED) --out "$(or $(OUT),runs/soak)"

audit: ## look all pinned packages up among the known holes (asks pypi.org; the tool has an environment of its own)
	@if [[ ! -x .audit/bin/pip-audit ]]; then "$(PYTHON)" -m venv .audit && .audit/bin/pip install --quiet pip-audit==2.10.1; fi
	@.audit/bin/pip-audit --requirement requirements/constraints.txt --no-deps --disable-pip --strict $(ARGS)

lint: setup ## ruff and mypy
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy

bench: setup ## measure the speed of the network, of the grasp synthesis and of the arm's planning (with its checks)
	@$(IN_ENV) dgs bench-inference $(ARGS)
	@$(IN_ENV) OMP_NUM_THREADS=1 dgs bench-synthesis --json docs/results/synthesis_rate.json
	@$(IN_ENV) OMP_NUM_THREADS=1 dgs bench-planning --json docs/results/arm_planning.json --doc docs/arm_executor.md

evaluate: setup ## all tables of the paper in simulation (hours; goes on where it stopped): make evaluate SCENES=60 OUT=folder
	@$(IN_ENV) for name in stages table2 paper; do \
	  dgs experiment $$name --scenes $(or $(SCENES),60) --seed $(SEED) --out "$(or $(OUT),runs/evaluation)/$$name" $(ARGS); done

docs: setup ## the documentation as a site, in site/
	@$(VENV)/bin/mkdocs build --strict --quiet

constraints: ## write the versions installed in the virtual environment to requirements/constraints.txt
	@$(VENV)/bin/python requirements/freeze.py

clean: ## remove what was built (the virtual environment stays; rm -r .venv removes that too)
	rm -rf ros2_ws/build ros2_ws/install ros2_ws/log ros2_ws/underlay_build ros2_ws/underlay_install
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
