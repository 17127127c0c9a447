# SPDX-License-Identifier: Apache-2.0
"""Evaluations on the emulated lab, through the live graph."""
