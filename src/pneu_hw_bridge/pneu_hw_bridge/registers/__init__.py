# SPDX-License-Identifier: Apache-2.0
"""Register maps: which Modbus registers hold which command or reading, and in which form."""
