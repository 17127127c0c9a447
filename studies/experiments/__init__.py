# SPDX-License-Identifier: Apache-2.0
"""Does a designed recording tell what a random one left open? Pairs of effects, and calibrations.

Plants have finer cells and another numerical flux than the models, and no plant is the model of
anything else.
"""
