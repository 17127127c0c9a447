# SPDX-License-Identifier: Apache-2.0
"""Tuning of PID and feed-forward PID in simulation."""
