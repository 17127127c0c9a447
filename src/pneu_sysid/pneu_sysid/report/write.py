# SPDX-License-Identifier: Apache-2.0
"""Puts the sections, the style and the script together into one self-contained HTML file."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from pneu_common.files import whole
from pneu_sysid.report.contents import read_contents
from pneu_sysid.report.markup import Markup, join, tag
from pneu_sysid.report.sections import SECTIONS

_SCRIPTS = ("errors.js", "viewer.js", "page.js")
_SIGNS = "Pressures are absolute; errors are measured minus model."


def write_report(
    path: str | Path,
    *,
    compare: Mapping[str, Any] | None = None,
    fit: Mapping[str, Any] | None = None,
    diagnose: Mapping[str, Any] | None = None,
    learn: Mapping[str, Any] | None = None,
    title: str | None = None,
) -> Path:
    """Write the HTML report of any of the four results.

    The file loads nothing: style, script and data are inside, and its content security policy
    lets only that script run. It is written aside and put in place when whole.

    Args:
        path: File to write, replaced if it is there.
        compare: Result of `pneu compare` (schema pneu.compare/1), or None.
        fit: Result of `pneu fit` (schema pneu.fit/1), or None.
        diagnose: Result of `pneu diagnose` (schema pneu.diagnose/1), or None.
        learn: Result of `pneu learn` (schema pneu.learn/1), or None.
        title: Heading of the page; the name of the recording by default.

    Returns:
        The path of the file.

    Raises:
        InputError: No result was given, a result has another schema, or the file cannot be
            written.
    """
    contents = read_contents({"compare": compare, "fit": fit, "diagnose": diagnose, "learn": learn})
    heading = title or ", ".join(contents.head("recording")) or "Pneu report"

    sections = [(s.ID, s.TITLE, s.render(contents)) for s in SECTIONS]
    script = "\n".join(_template(name) for name in _SCRIPTS)
    return write_page(
        path, heading, sections, ", ".join(contents.head("pneu_version")), _SIGNS, script
    )


def write_page(
    path: str | Path,
    heading: str,
    sections: Sequence[tuple[str, str, Markup]],
    versions: str,
    note: str,
    script: str = "",
) -> Path:
    """Write a page of sections, aside and put in place when whole.

    Args:
        path: File to write, replaced if it is there.
        heading: Of the page.
        sections: Identifier, title and body of each; an empty body is left out.
        versions: Of the program that made the results.
        note: How signs and units are meant.
        script: What may run in it.

    Returns:
        The path of the file.

    Raises:
        InputError: The file cannot be written.
    """
    shown = [(name, title, body) for name, title, body in sections if body]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    page = Template(_template("page.html")).substitute(
        title=join(heading),
        script_hash=digest,
        style=_template("style.css"),
        navigation=join([tag("a", title, href=f"#{name}") for name, title, _ in shown]),
        sections=join(
            [
                tag("section", tag("h2", title), body, id=name, class_=name)
                for name, title, body in shown
            ]
        ),
        versions=join(versions or "of an unknown version"),
        note=join(note),
        script=script,
    )
    path = Path(path)
    with whole(path) as aside:
        # A lone surrogate in a name cannot be encoded; it becomes a character reference.
        aside.write_bytes(page.encode("utf-8", "xmlcharrefreplace"))
    return path


def _template(name: str) -> str:
    return (files("pneu_sysid.report") / "templates" / name).read_text(encoding="utf-8")
