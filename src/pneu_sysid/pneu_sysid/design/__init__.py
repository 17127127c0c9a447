# SPDX-License-Identifier: Apache-2.0
"""The next experiment: commands that tell most of a rig's numbers, or of what it may lack."""
