# SPDX-License-Identifier: Apache-2.0
"""Mutation analysis: put faults into the source, one at a time, and see whether a test fails."""
