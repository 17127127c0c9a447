# SPDX-License-Identifier: Apache-2.0
"""The reference of rig files is current, complete, and its example is a rig."""

import json
import re
from pathlib import Path

from ruamel.yaml import YAML

from pneu_sim.rig import load_rig
from pneu_sim.rig.document import as_markdown
from pneu_sim.rig.parameters import get_parameter
from pneu_sim.rig.schema import Rig

HOUSE = Path(__file__).parents[3]


def test_the_page_is_up_to_date() -> None:
    page = (HOUSE / "docs" / "rig.md").read_text(encoding="utf-8")
    assert page == as_markdown(), "run python -m pneu_sim.rig.document > docs/rig.md"


def test_every_key_of_the_schema_is_on_the_page_with_its_meaning() -> None:
    """Pydantic's own JSON schema is the independent list of keys."""
    page = as_markdown()
    schema = Rig.model_json_schema(by_alias=True)
    parts = {"Rig": schema, **schema["$defs"]}
    assert len(parts) > 15
    for name, part in parts.items():
        section = page.split(f"## {name}\n")[1].split("\n## ")[0]
        rows = dict(re.findall(r"^\| `(\w+)` \|.*\| (.+) \|$", section, flags=re.MULTILINE))
        assert list(rows) == list(part["properties"]), name
        for key, meaning in rows.items():
            assert len(meaning.split()) > 1 or meaning.endswith("."), f"{name}.{key}"


def test_the_example_of_the_page_is_a_sound_rig(tmp_path: Path) -> None:
    text, kinds = re.findall(r"```yaml\n(.*?)```", as_markdown(), flags=re.DOTALL)
    path = tmp_path / "bench.yaml"
    path.write_text(text)
    rig = load_rig(path)
    assert rig.pipes["tube"].to_node == "closed"
    assert rig.taps["end"].channel is not None
    # the valves of the second one, between vessels of the nodes' names
    vessels = {name: {"volume_m3": 1e-4} for name in ("cap", "rod", "muscle", "bladder")}
    around = {
        "reservoirs": {"tank": {"pressure_pa": 7e5}, "room": {"pressure_pa": 1e5}},
        "chambers": vessels,
        "commands": {"arm_v": {}, "duty": {}, "preload_v": {}},
    }
    valves = YAML(typ="safe").load(kinds)
    plain = rig.dump() | around | valves
    plain["pipes"]["tube"]["from"] = "cap"
    path.write_text(json.dumps(plain))
    found = load_rig(path)
    assert list(found.valves["arm"].ports) == ["supply_a", "supply_b", "exhaust_a", "exhaust_b"]
    for name in (
        "valves.arm.ports.supply_a.conductance_m3_s_pa",
        "valves.preload.regulator.dead_zone_pa",
    ):
        assert name in as_markdown() and get_parameter(found, name) > 0.0
