# SPDX-License-Identifier: Apache-2.0
"""Simulation of pneumatic rigs: valves, tubes and chambers.

A rig is described by one YAML file and simulated either by the quasi-one-dimensional equations of
gas dynamics or by lumped models of the same rig. Physical effects are named parts that can be
attached to a rig at a place. All quantities are in SI units and pressures are absolute.
"""
