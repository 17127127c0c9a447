# SPDX-License-Identifier: Apache-2.0
"""HTML that is escaped by construction: only `tag` makes markup, any other string is text."""

import html
from collections.abc import Iterable
from typing import TypeAlias


class Markup(str):
    """Finished HTML; a plain `str` next to it is text and gets escaped."""

    __slots__ = ()


Child: TypeAlias = "str | int | float | Iterable[Child] | None"

_VOID = frozenset({"br", "col", "hr", "input", "meta", "wbr"})


def join(*children: Child) -> Markup:
    """Return the children as one piece of HTML.

    Args:
        children: Markup, text, numbers, nested iterables of these; None is left out.

    Returns:
        The HTML, text escaped.
    """
    parts: list[str] = []
    for child in children:
        if child is None:
            continue
        if isinstance(child, Markup):
            parts.append(child)
        elif isinstance(child, str | int | float):
            parts.append(html.escape(str(child)))
        else:
            parts.append(join(*child))
    return Markup("".join(parts))


def tag(name: str, *children: Child, **attributes: str | int | float | bool | None) -> Markup:
    """Return one HTML or SVG element.

    Args:
        name: Name of the element.
        children: See `join`.
        attributes: A trailing underscore is dropped and others become hyphens (`class_`,
            `aria_label`); None and False leave the attribute out, True writes it bare.

    Returns:
        The HTML of the element.
    """
    written = []
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        attribute = key.rstrip("_").replace("_", "-")
        written.append(
            f" {attribute}" if value is True else f' {attribute}="{html.escape(str(value))}"'
        )
    opening = f"<{name}{''.join(written)}>"
    return Markup(opening if name in _VOID else f"{opening}{join(*children)}</{name}>")


def table(
    caption: Child,
    header: Iterable[Child],
    rows: Iterable[Markup],
    *,
    class_: str | None = None,
) -> Markup:
    """Return a table in a frame that scrolls sideways when the page is narrow.

    Args:
        caption: What the table shows.
        header: One child per column; a `th` element is taken as it stands.
        rows: Finished `tr` elements.
        class_: CSS class of the table.

    Returns:
        The HTML.
    """
    cells = [
        cell
        if isinstance(cell, Markup) and cell.startswith("<th")
        else tag("th", cell, scope="col")
        for cell in header
    ]
    return tag(
        "div",
        tag(
            "table",
            tag("caption", caption),
            tag("thead", tag("tr", cells)),
            tag("tbody", rows),
            class_=class_,
        ),
        class_="scroll",
    )
