# SPDX-License-Identifier: Apache-2.0
"""The catalogue of effects for people: rows for ``pneu effects``, and ``docs/effects.md``."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.registry import BUILT_IN, registry
from pneu_sim.rig.schema import Rig

_HEAD = """\
# Physical effects

What a rig may have and its nominal model may lack. `pneu effects` lists them, `pneu diagnose` ranks
them against a recording, `pneu add EFFECT@PLACE` attaches one to a rig file:

```yaml
effects:
- {effect: leak, place: tube, parameters: {area_m2: 1.6e-8, position_m: 2.5}}
```

The first parameter of each is its strength; at the value *absent* the rig behaves as if the effect
were not there. An effect adds to what the rig already has, and may be attached more than once.
*Typical* is a strength that a laboratory rig clearly feels. Your own effects go in one file, see
`examples/my_effect.py`; `pneu effects --prove NAME --rig RIG` verifies one.
Deviations of the built-in effects from their references: [verification](effects_proven.md).

This page is made by `python -m pneu_sim.effects.document`.
"""


@dataclass(frozen=True)
class Row:
    """One effect in the list of effects.

    Attributes:
        name: Identifier.
        title: A few words.
        where: Kind of part, or the places on a given rig.
        strength: Name of the strength parameter.
        unit: Its unit.
        typical: A strength that is clearly felt.
        shape: Names of the further parameters.
    """

    name: str
    title: str
    where: str
    strength: str
    unit: str
    typical: str
    shape: str


def as_table(rig: Rig | None = None) -> list[Row]:
    """Every known effect, those of users included, as rows of a table.

    Args:
        rig: Lists only effects that this rig can have, and where; None lists all.
    """
    rows = []
    for effect in registry().values():
        places = None if rig is None else effect.available_places(rig)
        if places == []:
            continue
        rows.append(_row(effect, effect.where if places is None else ", ".join(places)))
    return rows


def as_markdown() -> str:
    """The page of the built-in effects."""
    effects = [kind() for kind in BUILT_IN]
    rows = [_row(effect, effect.where) for effect in effects]
    lines = [_HEAD]
    lines += _table(
        ("effect", "what", "where", "strength", "unit", "typical"),
        [(f"[{r.name}](#{r.name})", r.title, r.where, r.strength, r.unit, r.typical) for r in rows],
    )
    for effect in effects:
        lines += [
            f"\n## {effect.name}\n",
            f"{(type(effect).__doc__ or '').strip().splitlines()[0]}\n",
            f"- Law: `{effect.formula}`",
            f"- Source: {effect.source}",
            f"- To tell it from its look-alikes: {effect.next_experiment}",
            *(
                [f"- The same as, on some rigs: {', '.join(effect.indistinguishable_from)}"]
                if effect.indistinguishable_from
                else []
            ),
            "",
        ]
        lines += _table(
            ("parameter", "unit", "absent or usual", "lower", "upper", "typical"),
            [
                (p.name, p.unit, f"{p.absent:g}", f"{p.lower:g}", _upper(p), f"{p.typical:g}")
                for p in effect.parameters
            ],
        )
    return "\n".join(lines) + "\n"


def _row(effect: Effect, where: str) -> Row:
    strength, *shape = effect.parameters
    return Row(
        name=effect.name,
        title=effect.title,
        where=where,
        strength=strength.name,
        unit=strength.unit,
        typical=f"{strength.typical:g}",
        shape=", ".join(p.name for p in shape),
    )


def _upper(parameter: EffectParameter) -> str:
    return "pipe's length" if math.isinf(parameter.upper) else f"{parameter.upper:g}"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    ruled = [head, ("---",) * len(head), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in ruled]


if __name__ == "__main__":
    print(as_markdown(), end="")
