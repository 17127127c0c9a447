# SPDX-License-Identifier: Apache-2.0
"""Slow studies, each with its own make target; their results are shown in ``docs``."""
