# SPDX-License-Identifier: Apache-2.0
"""rosbag2 recordings in MCAP files: writing, reading, recovery, and what `bag info` prints."""
