# SPDX-License-Identifier: Apache-2.0
"""The emulated lab: a Modbus device in front of a rig that is simulated in real time."""
