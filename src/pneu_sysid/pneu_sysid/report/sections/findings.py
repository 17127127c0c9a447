# SPDX-License-Identifier: Apache-2.0
"""What was found wrong or odd in the recording, and how it was handled."""

from pneu_sysid.report.contents import Contents
from pneu_sysid.report.markup import Markup, tag

ID = "findings"
TITLE = "Findings in the recording"


def render(contents: Contents) -> Markup:
    """Return the findings as a list, or say that there are none.

    Args:
        contents: The results to report.
    """
    if not contents.findings:
        return tag("p", "No gaps, duplicates, jumps or invalid samples were reported.")
    return tag("ul", [tag("li", line) for line in contents.findings])
