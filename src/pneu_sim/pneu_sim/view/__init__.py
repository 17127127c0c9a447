# SPDX-License-Identifier: Apache-2.0
"""Robots for viewers: their links and joints as a tree of frames, and as URDF."""
