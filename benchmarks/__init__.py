# SPDX-License-Identifier: Apache-2.0
"""Speed and accuracy of the solver and of the identification, measured beside other solvers.

``make bench`` runs every subject and rewrites ``benchmarks/results.json`` and
``docs/benchmarks.md``; ``python -m benchmarks kernel rig`` runs some of them.
"""
