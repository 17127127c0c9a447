# SPDX-License-Identifier: Apache-2.0
"""What the README shows works: its rig, its effect, its commands, its targets, its links."""

import re
from pathlib import Path

import pytest
import typer.main

from pneu_common.cli import build_app
from pneu_sim.effects import load_effect_file, registry
from pneu_sim.effects.registry import _loaded
from pneu_sim.rig import load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import AttachedEffect

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language):
    """The one code block of a language."""
    (text,) = re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)
    return text


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text(block("yaml"))
    return load_rig(path)


def test_rig_file_of_the_readme_can_be_built(rig):
    assert build(rig).plan.taps == ["end"]


def test_effect_of_the_readme_acts_and_vanishes_at_zero(rig, tmp_path):
    before = registry()
    path = tmp_path / "clogged_filter.py"
    path.write_text(block("python"))
    try:
        (name,) = load_effect_file(path)
        plain = build(rig).cell

        def with_resistance(value):
            rig.effects = [
                AttachedEffect(effect=name, place="tube", parameters={"resistance_pa_s_m": value})
            ]
            return build(rig).cell

        assert (with_resistance(0.0) == plain).all()
        assert (with_resistance(300.0) != plain).any()
        assert f'{name} = "my_package.{name}:CloggedFilter"' in block("toml")
    finally:
        _loaded.clear()
        _loaded.update(before)


def test_commands_of_the_readme_exist_and_none_is_left_out():
    known = typer.main.get_command(build_app()).commands
    told = dict(re.findall(r"^\| `pneu ([\w-]+)([^`]*)`", README, flags=re.MULTILINE))
    row = re.search(r"^\| `pneu run`(.*)\| as their `ros2` namesakes", README, flags=re.MULTILINE)
    namesakes = {"run", *re.findall(r"`(\w+)`", row[1])}
    assert set(told) | namesakes == set(known)
    for name, words in told.items():
        options = {option for p in known[name].params for option in getattr(p, "opts", [])}
        assert set(re.findall(r"(?<!\w)--?[a-z]+", words)) <= options, name


def test_targets_of_the_readme_exist():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, flags=re.MULTILINE))
    told = set(re.findall(r"(?:`|^)make ([a-z-]+)", README, flags=re.MULTILINE))
    assert {"demo", "test"} <= told <= targets


PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("data/**/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    broken = []
    for link in links:
        path, _, anchor = link.partition("#")
        if ":" in path:  # a web address
            continue
        target = (page.parent / path) if path else page
        if not target.exists():
            broken.append(link)
        elif anchor and target.suffix == ".md":
            headings = re.findall(r"^#+ (.+)$", target.read_text(encoding="utf-8"), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}
            if anchor not in slugs:
                broken.append(link)
    assert not broken
