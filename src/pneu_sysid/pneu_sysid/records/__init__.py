# SPDX-License-Identifier: Apache-2.0
"""Recordings of a rig: bags and text files onto one uniform grid, with what was wrong."""

from pneu_sysid.records.bag import bag_topics
from pneu_sysid.records.noise import noise_floor_pa
from pneu_sysid.records.read import read_recording
from pneu_sysid.records.recording import Finding, Recording

__all__ = ["Finding", "Recording", "bag_topics", "noise_floor_pa", "read_recording"]
