# SPDX-License-Identifier: Apache-2.0
"""Schematics of all rigs that come with the repository: everything is there, tubes to scale."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pneu_sim.rig.load import load_rig
from pneu_workbench.schematic import SHORTEST_PX, layout, links_of, schematic

RIGS = sorted((Path(__file__).resolve().parents[3] / "rigs").glob("*.yaml"))


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_everything_of_a_rig_is_drawn_once(path: Path) -> None:
    rig = load_rig(path)
    drawn = schematic(rig)
    words = [str(text.text) for text in ElementTree.fromstring(drawn).iter("text")]
    for name, pipe in rig.pipes.items():
        assert words.count(f"{name}, {pipe.length_m:.3g} m") == 1
    for name in (*rig.taps, *(f"{v}.{port}" for v, of in rig.valves.items() for port in of.ports)):
        assert name in words
    assert {link.name for link, *_ in layout(rig).links} == {link.name for link in links_of(rig)}
    for name in rig.cylinders:
        assert name in words
    # with as much room on the right as on the left of what lies outermost
    _, _, wide, high = map(float, ElementTree.fromstring(drawn).attrib["viewBox"].split())
    across = [x for x, _ in layout(rig).nodes.values()]
    assert wide - max(across) >= min(across) and high > max(
        row for _, row in layout(rig).nodes.values()
    )


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_no_way_lies_on_another(path: Path) -> None:
    at = layout(load_rig(path))
    taken: dict[int, list[tuple[float, float]]] = {}
    for _, a, b in at.links:
        (x, _), (y, row) = at.nodes[a], at.nodes[b]
        begin, end = min(x, y), max(x, y)
        for other_begin, other_end in taken.setdefault(row, []):
            assert end <= other_begin + 1e-6 or begin >= other_end - 1e-6
        taken[row].append((begin, end))


def test_tubes_and_taps_are_to_scale() -> None:
    rig = load_rig(next(path for path in RIGS if path.stem == "rig_a"))
    at = layout(rig)
    widths = {
        link.name: abs(at.nodes[b][0] - at.nodes[a][0])
        for link, a, b in at.links
        if link.kind == "pipe"
    }
    assert widths["tube"] / widths["supply_line"] == pytest.approx(2.5)
    assert widths["exhaust_tube"] == SHORTEST_PX  # too short to be seen to scale
    begin, middle, end = (at.along("tube", x) for x in (0.0, 1.25, 2.5))
    assert begin and middle and end
    assert middle[0] - begin[0] == pytest.approx(0.5 * widths["tube"])
    assert end[0] - begin[0] == pytest.approx(widths["tube"])
    assert at.along("nowhere", 1.0) is None


def test_a_candidate_is_marked_where_it_is() -> None:
    rig = load_rig(next(path for path in RIGS if path.stem == "rig_a"))
    plain, marked = schematic(rig), schematic(rig, "tube", 2.0)
    assert "marked" not in plain and 'class="mark"' not in plain
    spot = layout(rig).along("tube", 2.0)
    assert spot is not None
    assert f'<circle cx="{spot[0]:.1f}" cy="{spot[1]:.1f}" r="11" class="mark"/>' in marked
    assert len(re.findall("pipe marked", marked)) == 1
    assert len(re.findall('"valve marked"', schematic(rig, "valve.exhaust"))) == 1
    assert len(re.findall('"valve marked"', schematic(rig, "valve"))) == 2  # all of its ports


def test_names_with_markup_are_words() -> None:
    rig = load_rig(next(path for path in RIGS if path.stem == "rig_a"))
    evil = "<script>alert(1)</script>"
    taps = {evil: rig.taps["end"]}
    drawn = schematic(rig.model_copy(update={"taps": taps, "name": f'"{evil}'}))
    assert "<script" not in drawn
    assert evil in [text.text for text in ElementTree.fromstring(drawn).iter("text")]
