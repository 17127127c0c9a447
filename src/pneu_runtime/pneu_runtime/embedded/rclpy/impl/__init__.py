# SPDX-License-Identifier: Apache-2.0
"""Loggers and their severities, under the names of the genuine package."""
