# SPDX-License-Identifier: Apache-2.0
"""A rig drawn as a schematic: sources, valves, tubes to scale with their taps, what they end in.

It is laid out from the source with the highest pressure on: what flows on goes to the right, what
branches off gets a row of its own. Lengths along tubes are to scale, and nothing else.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape

from pneu_sim.rig.schema import Rig

TUBES_PX = 620.0
"""Width of the longest way along tubes."""
PORT_PX = 96.0
ROW_PX = 92.0
EDGE_PX = 78.0
SHORTEST_PX = 84.0
"""Of a tube that could not be seen else; it says its length, as all do."""
SINK = "#"
"""Between the name of a sink and its number."""


@dataclass(frozen=True)
class Link:
    """A way from node to node.

    Attributes:
        kind: ``pipe``, ``port`` or ``orifice``.
        name: Of the pipe, `valve.port`, or of the orifice.
        begin: The node that it is measured from.
        end: The other.
        length_m: Of a pipe; 0 of others.
    """

    kind: str
    name: str
    begin: str
    end: str
    length_m: float = 0.0


@dataclass
class Layout:
    """Where everything is, px.

    Attributes:
        nodes: (x, row) by key; sinks stand at the end of every way that leads to them, so the key
            of one has a number behind its name.
        links: With the keys from and to which they are drawn, in that order.
        px_per_m: Scale of tubes.
    """

    nodes: dict[str, tuple[float, int]] = field(default_factory=dict)
    links: list[tuple[Link, str, str]] = field(default_factory=list)
    px_per_m: float = 1.0

    def width_of(self, link: Link) -> float:
        """How wide a link is drawn.

        Args:
            link: It.
        """
        if link.kind != "pipe":
            return PORT_PX
        return max(self.px_per_m * link.length_m, SHORTEST_PX)

    def along(self, name: str, position_m: float) -> tuple[float, float] | None:
        """Where a position along a pipe is drawn; None where there is no such pipe.

        Args:
            name: Of the pipe.
            position_m: From its begin, m.
        """
        for link, reached, to in self.links:
            if link.kind == "pipe" and link.name == name:
                (a, _), (b, row) = self.nodes[reached], self.nodes[to]
                if link.begin != reached:
                    a, b = b, a
                share = min(max(position_m / link.length_m, 0.0), 1.0)
                return a + share * (b - a), y_of(row)
        return None


def y_of(row: int) -> float:
    """Height of a row, px.

    Args:
        row: Which.
    """
    return 46.0 + ROW_PX * row


def links_of(rig: Rig) -> Iterator[Link]:
    """All ways from node to node.

    Args:
        rig: The rig.
    """
    for name, pipe in rig.pipes.items():
        yield Link("pipe", name, pipe.from_node, pipe.to_node, pipe.length_m)
    for valve, of in rig.valves.items():
        for port, one in of.ports.items():
            yield Link("port", f"{valve}.{port}", one.from_node, one.to_node)
    for name, orifice in rig.orifices.items():
        yield Link("orifice", name, orifice.from_node, orifice.to_node)


def layout(rig: Rig) -> Layout:
    """Lays a rig out.

    Args:
        rig: The rig.
    """
    links = list(links_of(rig))
    longest = max((link.length_m for link in links), default=1.0) or 1.0
    total = sum(link.length_m for link in links) or 1.0
    out = Layout(px_per_m=TUBES_PX / max(longest, 0.6 * total))
    left = list(links)
    rows = 0
    sources = sorted(rig.reservoirs, key=lambda name: -rig.reservoirs[name].pressure_pa)
    starts = [*sources, *(link.begin for link in links)]

    def follow(node: str) -> None:
        nonlocal rows
        first = True
        # tubes first, so that the way straight on is a tube where there is one
        own = sorted((x for x in links if node in (x.begin, x.end)), key=lambda x: x.kind != "pipe")
        for link in own:
            if link not in left:
                continue
            left.remove(link)
            other = link.end if node == link.begin else link.begin
            if other in out.nodes and other not in rig.reservoirs:
                out.links.append((link, node, other))  # a way round
                continue
            x, row = out.nodes[node]
            if not first:
                rows += 1
                row = rows
            first = False
            key = f"{other}{SINK}{len(out.links)}" if other in rig.reservoirs else other
            out.links.append((link, node, key))
            out.nodes[key] = (x + out.width_of(link), row)
            if other not in rig.reservoirs:
                follow(other)

    for start in starts:
        if start not in out.nodes and any(start in (one.begin, one.end) for one in left):
            if out.nodes:
                rows += 1
            out.nodes[start] = (EDGE_PX, rows)
            follow(start)
    return out


def schematic(rig: Rig, place: str | None = None, position_m: float | None = None) -> str:
    """A rig as SVG.

    Args:
        rig: The rig.
        place: A part that is marked, `part` or `valve.port`.
        position_m: Where along it, if it is a pipe, m.
    """
    at = layout(rig)
    wide = max((x for x, _ in at.nodes.values()), default=0.0) + EDGE_PX + 20.0
    high = y_of(max((row for _, row in at.nodes.values()), default=0)) + 50.0
    marked = set() if place is None else {place, place.split(".")[0]}
    parts = [
        f'<svg viewBox="0 0 {wide:.0f} {high:.0f}" role="img" class="pneu-schematic"'
        f' style="width:100%;max-width:{1.4 * wide:.0f}px"'
        f' aria-label="{escape("Schematic of " + rig.name)}">'
    ]
    for link, reached, to in at.links:
        whole = place is not None and link.name.split(".")[0] == place
        parts += _link(at, link, reached, to, link.name in marked or whole)
    ends = _ends(rig)
    for node, (x, row) in at.nodes.items():
        parts += _node(node, x, y_of(row), ends.get(node, ""), rig, marked)
    for name, tap in rig.taps.items():
        spot = None
        if tap.pipe is not None:
            spot = at.along(tap.pipe, tap.position_m or 0.0)
        elif tap.chamber in at.nodes:
            x, row = at.nodes[tap.chamber]
            spot = x + 30.0, y_of(row) - 15.0
        if spot is not None:
            x, y = spot
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" class="tap"/>')
            parts.append(_text(x, y - 13.0, name, "tap-name"))
    if place is not None and position_m is not None and (spot := at.along(place, position_m)):
        x, y = spot
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="11" class="mark"/>')
    parts.append("</svg>")
    return "".join(parts)


def _ends(rig: Rig) -> dict[str, str]:
    """What nodes end in, by node: `chamber:name`, `cylinder:name:side`."""
    ends = {name: f"chamber:{name}" for name in rig.chambers}
    for name, cylinder in rig.cylinders.items():
        for side in ("head", "rod"):
            chamber = getattr(cylinder, side, None)
            node = getattr(chamber, "node", None)
            if node is not None:
                ends[node] = f"cylinder:{name}:{side}"
    return ends


def _text(x: float, y: float, words: str, kind: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}">{escape(words)}</text>'


def _link(at: Layout, link: Link, reached: str, to: str, marked: bool) -> list[str]:
    (a, from_row), (b, row) = at.nodes[reached], at.nodes[to]
    y, above = y_of(row), y_of(from_row)
    kind = f"{link.kind}{' marked' if marked else ''}"
    lines = []
    if from_row != row:
        lines.append(f'<path d="M{a:.1f} {above:.1f} V{y:.1f}" class="lead"/>')
    lines.append(f'<path d="M{a:.1f} {y:.1f} H{b:.1f}" class="{kind}"/>')
    middle = 0.5 * (a + b)
    if link.kind == "pipe":
        words = f"{link.name}, {link.length_m:.3g} m"
        # a short tube's name is wider than it, and would lie over what is at its ends
        below = 20.0 if 5.5 * len(words) < abs(b - a) else 46.0
        lines.append(_text(middle, y + below, words))
    else:
        s = 9.0
        lines.append(
            f'<path d="M{middle - s:.1f} {y - s:.1f} L{middle + s:.1f} {y + s:.1f} V{y - s:.1f}'
            f' L{middle - s:.1f} {y + s:.1f} Z" class="valve{" marked" if marked else ""}"/>'
        )
        lines.append(_text(middle, y + 32.0, link.name))
    return lines


def _node(key: str, x: float, y: float, end: str, rig: Rig, marked: set[str]) -> list[str]:
    name, sink, _ = key.partition(SINK)
    if name in rig.reservoirs:
        bar = rig.reservoirs[name].pressure_pa / 1e5
        kind = f"reservoir{' marked' if name in marked else ''}"
        left = x if sink else x - 68.0
        box = f'x="{left:.1f}" y="{y - 17:.1f}" width="68" height="34" rx="8"'
        return [
            f'<rect {box} class="{kind}"/>',
            _text(left + 34.0, y - 1.0, name),
            _text(left + 34.0, y + 12.0, f"{bar:.2f} bar"),
        ]
    if end:
        words = end.split(":")
        kind = f"vessel{' marked' if marked & set(words) else ''}"
        return [
            f'<rect x="{x:.1f}" y="{y - 15:.1f}" width="60" height="30" class="{kind}"/>',
            _text(x + 30.0, y - 1.0, words[1]),
            *([_text(x + 30.0, y + 11.0, words[2])] if len(words) > 2 else []),
        ]
    only = sum(key in (link.begin, link.end) for link in links_of(rig)) == 1
    if only:  # a closed end
        return [f'<path d="M{x:.1f} {y - 10:.1f} V{y + 10:.1f}" class="cap"/>']
    return [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" class="node"/>']


STYLE = """
.pneu-schematic { --ink: #333333; --tube: #44546a; --mark: #b3261e; --fill: #e8eef7; }
.body--dark .pneu-schematic { --ink: #d8d8d8; --tube: #9db2d0; --mark: #ff8a80; --fill: #263349; }
.pneu-schematic text { font: 10px sans-serif; fill: var(--ink); text-anchor: middle; }
.pneu-schematic .pipe { stroke: var(--tube); stroke-width: 6; fill: none; }
.pneu-schematic .port, .pneu-schematic .orifice, .pneu-schematic .lead, .pneu-schematic .cap {
  stroke: var(--tube); stroke-width: 2; fill: none; }
.pneu-schematic .cap { stroke-width: 4; }
.pneu-schematic .valve, .pneu-schematic .reservoir, .pneu-schematic .vessel {
  fill: var(--fill); stroke: var(--tube); stroke-width: 1.5; }
.pneu-schematic .node { fill: var(--tube); }
.pneu-schematic .tap { fill: var(--fill); stroke: var(--ink); stroke-width: 1.5; }
.pneu-schematic .marked { stroke: var(--mark); stroke-width: 3; }
.pneu-schematic .pipe.marked { stroke-width: 8; }
.pneu-schematic .mark { fill: none; stroke: var(--mark); stroke-width: 3; }
"""
