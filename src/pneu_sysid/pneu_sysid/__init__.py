# SPDX-License-Identifier: Apache-2.0
"""Identification of pneumatic rigs from recordings.

Reads a recorded bag or CSV file, fits the parameters of a rig to it, shows where the model fails,
ranks the physical effects that could be missing, and adds them one by one while the error on
held-out data falls.
"""
