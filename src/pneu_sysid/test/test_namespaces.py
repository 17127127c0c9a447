# SPDX-License-Identifier: Apache-2.0
"""A rig with relative topics is in the namespace where all of them are, with their types."""

from pathlib import Path

import pytest

from pneu_sim.rig import load_rig
from pneu_sysid.nodes.namespaces import namespaces_of, relative_topics

RIGS = Path(__file__).parents[3] / "rigs"
RIG = load_rig(RIGS / "lab.yaml")
WANTED = relative_topics(RIG)


def at(base: str, without: str = "", kind: str = "") -> list[tuple[str, list[str]]]:
    return [(f"{base}{name}", [kind or of]) for name, of in WANTED.items() if name != without]


@pytest.mark.parametrize("base", ["/", "/lab/", "/a/b/"])
def test_it_is_found_where_all_topics_are(base):
    there = [*at(base), ("/diagnostics", ["diagnostic_msgs/msg/DiagnosticArray"])]
    assert namespaces_of(RIG, there) == [base.rstrip("/") or "/"]


def test_part_of_them_or_others_of_their_name_are_not_it():
    assert namespaces_of(RIG, []) == []
    assert namespaces_of(RIG, at("/lab/", without="taps/end/pressure")) == []
    assert namespaces_of(RIG, at("/lab/", kind="std_msgs/msg/String")) == []
    # names that merely end in the same letters
    assert namespaces_of(RIG, at("/lab/not_")) == []


def test_several_are_told():
    assert namespaces_of(RIG, [*at("/b/"), *at("/a/")]) == ["/a", "/b"]


def test_absolute_topics_need_none():
    assert namespaces_of(load_rig(RIGS / "rig_a_fitted.yaml"), []) == ["/"]
