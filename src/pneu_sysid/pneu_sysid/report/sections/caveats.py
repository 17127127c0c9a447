# SPDX-License-Identifier: Apache-2.0
"""What was not tested, so that silence is not read as absence."""

from pneu_sysid.report.contents import Contents, Result, both
from pneu_sysid.report.markup import Markup, join, tag

ID = "caveats"
TITLE = "What was not tested"


def render(contents: Contents) -> Markup:
    """Return the limits of these results.

    Args:
        contents: The results to report.
    """
    lines: list[Markup] = []
    diagnose = contents.diagnose
    if diagnose is None and contents.learn is None:
        lines.append(join("No candidate effect was tested: run pneu diagnose or pneu learn."))
    untested = [c for c in (diagnose or {}).get("candidates") or [] if c.get("tested") is False]
    if untested:
        names = ", ".join(_name(candidate) for candidate in untested)
        lines.append(
            join(
                "These candidates were listed but not tested on this recording: ",
                tag("code", names),
                ".",
            )
        )
    if diagnose is not None and not any(
        c.get("held_out_gain") is not None for c in diagnose.get("candidates") or []
    ):
        lines.append(join("No candidate was tested on held-out data."))
    steps = (contents.learn or {}).get("steps") or []
    if steps and not any(both(step, "held_out_rmse") for step in steps):
        lines.append(join("The learned rig was not tested on held-out data."))
    if contents.fit is not None and not both(contents.fit, "held_out_rmse"):
        lines.append(join("The fit was not tested on held-out data."))
    weak = [
        str(p.get("path"))
        for p in (contents.fit or {}).get("parameters") or []
        if p.get("identified") is False
    ]
    if weak:
        lines.append(
            join(
                "This recording does not determine ",
                tag("code", ", ".join(weak)),
                "; their values are not measurements.",
            )
        )
    silent = [name for name in contents.sensors if name not in contents.noise_floor]
    if silent:
        lines.append(
            join(
                "The sensor noise of ",
                tag("code", ", ".join(silent)),
                " is not known, so its errors are not rated.",
            )
        )
    if contents.compare is None:
        lines.append(join("Errors by regime and over time are not shown: run pneu compare."))
    lines.append(
        join(
            "Effects outside the catalogue, and conditions that the recording does not visit, "
            "are not tested. pneu effects lists the catalogue."
        )
    )
    return tag("ul", [tag("li", line) for line in lines])


def _name(candidate: Result) -> str:
    place = candidate.get("place")
    return f"{candidate.get('effect')} @ {place}" if place else str(candidate.get("effect"))
