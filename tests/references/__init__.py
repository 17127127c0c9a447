# SPDX-License-Identifier: Apache-2.0
"""Closed-form and semi-analytical references that the tests hold the solver against.

Written from published formulas only; nothing here imports the packages under test. Each module
is one subject, in SI units, absolute pascals.
"""
