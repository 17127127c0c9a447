# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `pneu` that work on a recording, a file for each.

The numerics are imported by the command that uses them: `pneu --help` does without.
"""
