# SPDX-License-Identifier: Apache-2.0
"""Arms that touch things: a hand file says what is driven, what is measured, and on which topics.

`settings` is the file, `loading` makes MuJoCo's model of it, `truth` what a plant has that nobody
was told, `world` the plant in time with sensors at their own rates, `drive` the law by which
motors follow commands. Simulation, bridge and emulated devices build from the same file.
"""
