# SPDX-License-Identifier: Apache-2.0
"""Recordings as an observer sees them: what it says of every sensor, of those it lacks, and why."""
