# SPDX-License-Identifier: Apache-2.0
"""Mechanisms that MuJoCo moves: any MJCF whose joints, tendons or sites pistons take hold of.

`settings` is what a rig file says, `loading` makes MuJoCo's model of it, `mechanism` holds the
mechanisms of all rigs side by side, and `coupling` moves gas and mechanism together. MuJoCo is an
extra of the package, `robots`; only what builds a mechanism imports it.
"""
