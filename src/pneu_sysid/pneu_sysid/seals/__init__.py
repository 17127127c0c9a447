# SPDX-License-Identifier: Apache-2.0
"""Friction of a cylinder's seals from drag tests: force, position and pressure; `pneu friction`."""
