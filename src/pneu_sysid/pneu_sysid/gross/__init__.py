# SPDX-License-Identifier: Apache-2.0
"""Gross errors of a rig file, told by a recording: sizes, wiring and places that a fit hides.

A datasheet is off by tens of percent everywhere, and leaves many times the noise before a fit. So
no two models are compared as they stand: each is first given what an ordinary fit would change
(flows, opening curves, spools, volumes and supplies within their usual uncertainty, by a few
Gauss-Newton steps on coarse cells), and what it leaves then is compared.
"""

from pneu_sysid.gross.findings import GrossError
from pneu_sysid.gross.search import gross_errors, refuse_gross_errors

__all__ = ["GrossError", "gross_errors", "refuse_gross_errors"]
