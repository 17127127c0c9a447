# SPDX-License-Identifier: Apache-2.0
"""The Modbus side of a bridge: one connection, one thread of its own, supervised."""
