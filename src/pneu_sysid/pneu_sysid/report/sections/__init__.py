# SPDX-License-Identifier: Apache-2.0
"""The sections of the report, in the order of the page.

Each is a module with `ID` (anchor and CSS class), `TITLE`, and `render(contents)`, which returns
HTML, empty where the results have nothing for it.
"""

from pneu_sysid.report.sections import (
    before_after,
    caveats,
    errors,
    experiments,
    findings,
    fit,
    overlay,
    ranking,
    residual_maps,
    verdict,
    waterfall,
)

SECTIONS = (
    verdict,
    before_after,
    waterfall,
    errors,
    overlay,
    residual_maps,
    ranking,
    experiments,
    fit,
    findings,
    caveats,
)
