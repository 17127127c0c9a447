# SPDX-License-Identifier: Apache-2.0
"""The HTML report of an identification: one file, no network, readable in any browser.

`write_report` takes the results of `pneu compare`, `fit`, `diagnose` and `learn` as the dicts that
`--json` writes, and makes one page of them. Each section is one file under `sections/`.
"""

from pneu_sysid.report.write import write_page as write_page
from pneu_sysid.report.write import write_report as write_report
