# SPDX-License-Identifier: Apache-2.0
"""Recordings of a rig: bags and text files, every signal at its own times, with what was wrong."""

from pneu_sim.signals import Signal
from pneu_sysid.records.container import bag_topics
from pneu_sysid.records.noise import NoiseFloor, noise_floor
from pneu_sysid.records.read import read_recording
from pneu_sysid.records.recording import Finding, Recording, begins_of, even_recording

__all__ = [
    "Finding",
    "NoiseFloor",
    "Recording",
    "Signal",
    "bag_topics",
    "begins_of",
    "even_recording",
    "noise_floor",
    "read_recording",
]
