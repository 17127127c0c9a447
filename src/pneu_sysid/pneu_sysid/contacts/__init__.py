# SPDX-License-Identifier: Apache-2.0
"""Contacts from recordings: scenes, trajectories, what touches, and which effect is missing."""
