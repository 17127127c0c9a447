# SPDX-License-Identifier: Apache-2.0
"""The packages of the repository, from the floor upwards: each may import those before it."""

PACKAGES = (
    "pneu_common",
    "pneu_runtime",
    "pneu_graph",
    "pneu_sim",
    "pneu_hw_bridge",
    "pneu_sysid",
    "pneu_policy",
    "pneu_workbench",
)
