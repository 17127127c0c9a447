# SPDX-License-Identifier: Apache-2.0
"""Reading of HTML reports in tests: elements, tables by heading and row, and shown numbers."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = frozenset({"br", "col", "hr", "img", "input", "link", "meta", "wbr"})
SUPERSCRIPT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
NUMBER = re.compile(r"[+−-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?:×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
DASHES = ("–", "-")


@dataclass(eq=False)
class Element:
    """An element of a page.

    Attributes:
        tag: Its name.
        attributes: Its attributes.
        children: Elements and texts inside it, in order.
    """

    tag: str
    attributes: dict[str, str]
    children: list["Element | str"] = field(default_factory=list)

    @property
    def text(self) -> str:
        """All text inside, in order."""
        return "".join(c if isinstance(c, str) else c.text for c in self.children)

    @property
    def classes(self) -> list[str]:
        """CSS classes."""
        return self.attributes.get("class", "").split()

    def number(self, name: str) -> float:
        """Return a numeric attribute."""
        return float(self.attributes[name])

    def every(self, tag: str | None = None, class_: str | None = None) -> Iterator["Element"]:
        """Yield the elements below with a tag and a class, in the order of the page."""
        for child in self.children:
            if isinstance(child, str):
                continue
            if tag in (None, child.tag) and (class_ is None or class_ in child.classes):
                yield child
            yield from child.every(tag, class_)

    def the(self, tag: str | None = None, class_: str | None = None) -> "Element":
        """Return the only element below with a tag and a class."""
        found = list(self.every(tag, class_))
        assert len(found) == 1, f"found {len(found)} of {tag} {class_}"
        return found[0]

    def section(self, name: str) -> "Element":
        """Return the section with an id."""
        return next(s for s in self.every("section") if s.attributes["id"] == name)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open = [Element("page", {})]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {key: value or "" for key, value in attrs})
        self.open[-1].children.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag: str) -> None:
        closed = self.open.pop().tag
        assert closed == tag, f"{tag} closes {closed}"

    def handle_data(self, data: str) -> None:
        self.open[-1].children.append(data)


def read_page(text: str) -> Element:
    """Return the root of a page in which every element is closed."""
    reader = _Reader()
    reader.feed(text)
    reader.close()
    assert len(reader.open) == 1
    return reader.open[0]


@dataclass
class Table:
    """A table with its spans resolved.

    Attributes:
        headings: Per column the texts of its headings, topmost first.
        rows: Per row of the body one element per column; None where nothing reaches.
    """

    headings: list[tuple[str, ...]]
    rows: list[list[Element | None]]

    def column(self, *heading: str) -> int:
        """Return the only column with these headings."""
        found = [k for k, own in enumerate(self.headings) if own == heading]
        assert len(found) == 1, f"{heading} is {len(found)} of {self.headings}"
        return found[0]


def read_table(element: Element) -> Table:
    """Return a table element as a grid."""
    head = _grid(list(element.the("thead").every("tr")))
    width = max(len(row) for row in head)
    # a title row may span more columns than there are
    body = [row[:width] for row in _grid(list(element.the("tbody").every("tr")))]
    headings = []
    for k in range(width):
        cells = [row[k] if k < len(row) else None for row in head]
        texts: list[str] = []
        for n, cell in enumerate(cells):
            if cell is not None and (n == 0 or cell is not cells[n - 1]):
                texts.append(cell.text.strip())
        headings.append(tuple(texts))
    return Table(headings, [row + [None] * (width - len(row)) for row in body])


def _grid(rows: list[Element]) -> list[list[Element | None]]:
    out: list[list[Element | None]] = [[] for _ in rows]
    for n, row in enumerate(rows):
        column = 0
        for cell in row.children:
            if isinstance(cell, str):
                continue
            while column < len(out[n]) and out[n][column] is not None:
                column += 1
            wide = int(cell.attributes.get("colspan", 1))
            for below in range(int(cell.attributes.get("rowspan", 1))):
                line = out[n + below]
                line += [None] * (column + wide - len(line))
                line[column : column + wide] = [cell] * wide
            column += wide
    return out


def shown(text: str) -> tuple[float, float]:
    """Return the first number of a text and half a unit of its last digit."""
    found = NUMBER.search(text)
    assert found, f"no number in {text!r}"
    mantissa, _, power = found[0].translate(SUPERSCRIPT).partition("×10")
    digits, _, exponent = mantissa.partition("e")
    scale = 10.0 ** (int(power or 0) + int(exponent or 0))
    whole, point, decimals = digits.partition(".")
    half = 0.5000001 * 10.0 ** -len(decimals)
    if not point:  # zeros at the end of a whole number may be rounded ones, from the third digit
        rounded = 0.5000001 * 10.0 ** (len(whole) - len(whole.rstrip("0")))
        half = max(half, min(rounded, 0.005 * abs(float(whole))))
    return float(digits) * scale, half * scale


def check(
    text: str, expected: float | None, coarsest: float = 0.06, digits: int | None = None
) -> None:
    """Assert that a text shows a number, rounded, and a dash where there is none.

    Args:
        text: A cell.
        expected: The number, in the unit of the cell.
        coarsest: Rounding error that is allowed, as a share of the number.
        digits: Significant digits that were asked for, where zeros at the end are left out.
    """
    if expected is None:
        assert text.strip() in DASHES, text
        return
    value, half = shown(text)
    if digits is not None:
        half = 0.5000001 * 10.0 ** (math.floor(math.log10(abs(expected))) - digits + 1)
        coarsest = 1.0
    assert abs(value - expected) <= half + 1e-9 * abs(expected), f"{text!r} is not {expected!r}"
    assert half <= coarsest * abs(expected), f"{text!r} is too coarse for {expected!r}"


def check_with_error(text: str, value: float, error: float | None, unit: str) -> None:
    """Assert that a text shows a value, its standard error and the unit.

    Args:
        text: A cell.
        value: The value, in the unit of the cell.
        error: Its standard error, in the same unit.
        unit: The unit, as people write it.
    """
    numbers, power = text, ""
    if text.startswith("("):
        numbers, _, power = text[1:].partition(")")
        factor = re.match(r"×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", power)
        assert factor, text
        numbers = numbers.replace(" ±", f"{factor[0]} ±") + factor[0]
        power = power[factor.end() :]
    first, _, second = numbers.partition("±")
    if error is None:
        assert "±" not in text
    else:
        check(second, error)
        # the value is rounded to the digits of its error
        assert abs(shown(first)[0] - value) <= max(shown(first)[1], 0.06 * error), text
    if error is None:
        check(first, value)
    assert text.endswith(unit), text
    assert unit or text.rstrip()[-1] in "0123456789⁰¹²³⁴⁵⁶⁷⁸⁹", text
