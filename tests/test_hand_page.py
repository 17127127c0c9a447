# SPDX-License-Identifier: Apache-2.0
"""The page of `make hand-tables`: what is made anew is replaced, the rest stays as it was."""

from pathlib import Path

from studies.hand_tables import EFFECTS, TITLES, page, sections

WITHOUT = {"sensor": "force", "rmse": 0.02, "with_it": 0.01, "span": 1.0}


def kept(rmse: float, sources: str) -> dict[str, object]:
    """A result of one stage, as it lies on disk."""
    return {"sources": sources, "figures": {"rows": [{**WITHOUT, "rmse": rmse}]}}


def test_sections_without_a_new_result_stay(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    effect = {"name": "lag", "words": "late", "right": ["a"], "verdict": "nothing", "minutes": 1.0,
              "sentence": "Nothing.", "finalists": []}  # fmt: skip
    page({"without": kept(0.02, "one"), "effect lag": {"sources": "one", "figures": effect}}, path)
    before = sections(path.read_text(encoding="utf-8"))
    assert set(before) == {TITLES[3], EFFECTS}
    page({"without": kept(0.05, "two")}, path)
    after = sections(path.read_text(encoding="utf-8"))
    assert after[EFFECTS] == before[EFFECTS]
    assert after[EFFECTS][-1].endswith("sources one.")
    assert any("5.0 %" in line for line in after[TITLES[3]])
    assert after[TITLES[3]][-1].endswith("sources two.")
    text = path.read_text(encoding="utf-8")
    page({}, path)  # nothing new changes nothing
    assert path.read_text(encoding="utf-8") == text
