# SPDX-License-Identifier: Apache-2.0
"""Numbers that several files of the API share."""

S_TO_NS = 1_000_000_000
S64_MAX = 2**63 - 1
