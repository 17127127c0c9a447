# SPDX-License-Identifier: Apache-2.0
# The tasks of this repository. Each builds what it needs in .venv from python3 and make alone.
#
# Numba keeps compiled kernels in __pycache__ beside their source, which here is always writable, so
# NUMBA_CACHE_DIR is left unset; set it yourself where the checkout is read-only. Only `make bench`,
# whose peers hold back Numba's version, has a cache of its own.

# Byte code is kept, whatever the shell says: a graph starts dozens of processes, and half the time
# that one takes to start goes into compiling its modules where it is not.
export PYTHONDONTWRITEBYTECODE :=

PYTHON ?= python3
VENV   := .venv
RUN    := $(VENV)/bin/python
# The solvers we compare with hold back versions of our own dependencies, so they live apart.
BENCH_VENV := .venv-bench
GPU_VENV   := .venv-gpu
ROS_VENV   := .venv-ros

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo demo-robot test test-long ros-venv test-ros bench lint format gpu bags observer predictive predictive-live tosses experiments hand-force hand-tables pushing kokoro effects simple-model ablations configurations cell-sizes learning folder-is-named exact calibration thinned \
	confusion thresholds moved faults fuzz mutate study-pressure clean clean-kernels

help:  ## list the targets
	@$(PYTHON) tools/make_help.py $(firstword $(MAKEFILE_LIST))

demo: $(VENV)/.ready-run  ## the whole story on a bag that comes with the repository
	@$(RUN) examples/demo.py
	@$(RUN) examples/live.py

demo-robot: $(VENV)/.ready-run  ## a robot behind Modbus with a hidden fault, named live; SEED=n
	@$(RUN) examples/live_robot.py $(if $(SEED),--seed $(SEED))

test: $(VENV)/.ready-dev  ## lint, type check and the tests
	@$(RUN) tools/run_tests.py --lint

test-long: $(VENV)/.ready-dev  ## slow: the tests that take longest, and not with `make test`
	@$(RUN) tools/run_tests.py --long

ros-venv: $(ROS_VENV)/.ready-ros  ## an environment with the genuine rclpy of ROS 2 Jazzy

test-ros: $(ROS_VENV)/.ready-ros  ## slow: nodes tested on the genuine rclpy, timed beside the embedded; STAGES=names
	@PNEU_RCLPY=ros $(ROS_VENV)/bin/python -m studies.ros $(STAGES)

lint: $(VENV)/.ready-dev  ## ruff (rules and format) and mypy
	@$(RUN) -m ruff check --quiet .
	@$(RUN) -m ruff format --check --quiet .
	@$(RUN) -m mypy --no-error-summary

format: $(VENV)/.ready-dev  ## let ruff put the sources in order
	@$(RUN) -m ruff check --fix .
	@$(RUN) -m ruff format .

bench: $(BENCH_VENV)/.ready-bench  ## speed and accuracy beside other solvers
	@NUMBA_CACHE_DIR=$(abspath $(BENCH_VENV))/numba $(BENCH_VENV)/bin/python -m benchmarks

gpu: $(GPU_VENV)/.ready-gpu  ## the gas on this machine's NVIDIA GPU: beside the processor, and how fast
	@NUMBA_CACHE_DIR=$(abspath $(GPU_VENV))/numba $(GPU_VENV)/bin/python -m studies.gpu

bags: folder-is-named $(VENV)/.ready-run  ## slow: fit and diagnose every bag of folders, BAGS=folders; PAGE=file
	@$(RUN) -m studies.bags $(BAGS) $(if $(PAGE),--page $(PAGE))

observer: folder-is-named $(VENV)/.ready-run  ## slow: what an observer sees of labelled bags of rigs A and B, BAGS=folder
	@$(RUN) -m studies.observer $(BAGS)

predictive: $(VENV)/.ready-dev  ## slow: table 9.1 with predictive control, in lock step; ARGS=options
	@$(RUN) -m studies.predictive $(ARGS)

predictive-live: $(VENV)/.ready-dev  ## slow: the same against the clock, on the emulated lab; ARGS=options
	@$(RUN) -m studies.predictive_live $(ARGS)

experiments: $(VENV)/.ready-dev  ## slow: do designed recordings tell what random ones left open? resumable
	@$(RUN) -m studies.experiments $(STAGES)

hand-force: $(VENV)/.ready-dev  ## slow: contact force estimated while an emulated arm moves; PAGE=file
	@$(RUN) -m studies.hand_force $(if $(TRUTH),--truth $(TRUTH)) $(if $(PAGE),--page $(PAGE))

hand-tables: $(VENV)/.ready-dev  ## slow: tables of thesis 2.7 and hidden effects of an emulated arm; STAGES=names
	@$(RUN) -m studies.hand_tables $(STAGES)

pushing: $(VENV)/.ready-dev  ## slow: policies that push a cylinder, trained and judged; STAGES=names
	@$(RUN) -m studies.pushing $(STAGES)

kokoro: $(VENV)/.ready-dev  ## slow: table 9.2, controllers of a joint made and judged; STAGES=names
	@$(RUN) -m studies.kokoro $(STAGES)

effects: $(VENV)/.ready-dev  ## verify every effect against references and common properties
	@$(RUN) -m studies.effects

simple-model: $(VENV)/.ready-dev  ## slow: thesis 7.5, a cart that learns in the full or in the simple model; ARGS=options
	@$(RUN) -m studies.simple_model $(ARGS)

ablations: $(VENV)/.ready-dev  ## slow: thesis 7.6, the same as a cart's sizes change; ARGS=options
	@$(RUN) -m studies.ablations $(ARGS)

configurations: $(VENV)/.ready-dev  ## slow: thesis 7.7, poles, arms and a dog in either model; ARGS=options
	@$(RUN) -m studies.configurations $(ARGS)

cell-sizes: $(VENV)/.ready-dev  ## slow: thesis 6.1, policies with cells of other sizes; ARGS=options
	@$(RUN) -m studies.cell_sizes $(ARGS)

learning: $(VENV)/.ready-dev  ## slow: the natural policy gradient beside PPO, same samples; ARGS=options
	@$(RUN) -m studies.learning $(ARGS)

tosses: $(BENCH_VENV)/.ready-bench  ## slow: objects really tossed, fitted, foretold, diagnosed; TOSSES=folder; PAGE=file
	@test -n "$(TOSSES)" || { echo "which folder holds the tosses? make tosses TOSSES=folder" >&2; exit 2; }
	@$(BENCH_VENV)/bin/python -m studies.tosses $(TOSSES) $(if $(PAGE),--page $(PAGE))

folder-is-named:
	@test -n "$(BAGS)" || { echo "which folder holds the bags? make bags BAGS=folder" >&2; exit 2; }

exact: $(VENV)/.ready-run  ## slow: exact models of rigs drawn at random, compared, diagnosed, fitted
	@$(RUN) -m studies.exact

calibration: $(VENV)/.ready-run  ## slow: rigs drawn at random, fitted from datasheets; BAGS=folders besides
	@$(RUN) -m studies.calibration $(BAGS)

thinned: folder-is-named $(VENV)/.ready-run  ## slow: labelled bags with fewer readings, BAGS=folder
	@$(RUN) -m studies.thinned "$(BAGS)"

confusion: $(VENV)/.ready-run  ## slow: every effect hidden on rigs drawn at random, and what is learned
	@$(RUN) -m studies.confusion

thresholds: $(VENV)/.ready-run  ## slow: what decides verdicts, halved and doubled (after confusion)
	@$(RUN) -m studies.thresholds

moved: $(VENV)/.ready-run  ## slow: verdicts with calibrations moved on purpose (after confusion)
	@$(RUN) -m studies.moved

faults: $(VENV)/.ready-dev  ## slow: what a bridge has to survive, idle and busy, at the device
	@$(RUN) -m studies.faults

fuzz: $(VENV)/.ready-dev  ## slow: mutated rig files, bags, CSVs and command lines
	@$(RUN) -m studies.fuzz

mutate: $(VENV)/.ready-mutate  ## slow: faults in the source, and whether the tests notice; ARGS=options
	@$(RUN) -m studies.mutation $(ARGS)

study-pressure: $(VENV)/.ready-study  ## slow: train, tune and prove pressure controllers (an hour)
	@$(RUN) -m studies.pressure

clean: clean-kernels  ## remove all that these targets have made
	@rm -rf $(VENV) $(BENCH_VENV) $(GPU_VENV) $(ROS_VENV) build dist pneu.egg-info out .mypy_cache .ruff_cache .pytest_cache

clean-kernels:  ## remove compiled kernels and byte code
	@find . -path './.*' -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

# What compares with a peer runs where the peers are. One stamp per set of requirements. A finished `dev` or `bench` also marks `run` as ready.
$(VENV)/.ready-run: pyproject.toml tools/environment.py
	@$(PYTHON) tools/environment.py $(VENV)

$(VENV)/.ready-dev: pyproject.toml tools/environment.py
	@$(PYTHON) tools/environment.py $(VENV) --extra dev

$(VENV)/.ready-mutate: pyproject.toml tools/environment.py
	@$(PYTHON) tools/environment.py $(VENV) --extra mutate

$(VENV)/.ready-study: pyproject.toml tools/environment.py
	@$(PYTHON) tools/environment.py $(VENV) --extra study

$(GPU_VENV)/.ready-gpu: pyproject.toml tools/environment.py
	@$(PYTHON) tools/environment.py $(GPU_VENV) --extra gpu

$(ROS_VENV)/.ready-ros: pyproject.toml tools/environment.py tools/ros_environment.py $(wildcard msgs/*.* msgs/*/*)
	@$(PYTHON) tools/ros_environment.py $(ROS_VENV)

$(BENCH_VENV)/.ready-bench: pyproject.toml tools/environment.py
	@$(PYTHON) tools/environment.py $(BENCH_VENV) --extra bench --optional
