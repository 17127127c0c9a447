# SPDX-License-Identifier: Apache-2.0
"""Bridges from the topics of the graph to valves and sensors, their safety, and an emulated lab."""
