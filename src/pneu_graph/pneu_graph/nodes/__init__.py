# SPDX-License-Identifier: Apache-2.0
"""Recorder and player, and what every node of the graph does alike."""
