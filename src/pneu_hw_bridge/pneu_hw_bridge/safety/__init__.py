# SPDX-License-Identifier: Apache-2.0
"""The last software between a command and a valve: limits, watchdogs, trips, emergency stop."""
