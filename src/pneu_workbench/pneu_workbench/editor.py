# SPDX-License-Identifier: Apache-2.0
"""The form in which a rig file is edited, or begun from a template, and channels are matched.

Every number is checked as it is typed, against the same schema as a file; the drawing follows.
"""

import math
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

from nicegui import run, ui

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_sim.channels import PRESSURES, TextFormat
from pneu_sim.init import TEMPLATES, kinds
from pneu_sim.rig.schema import Rig
from pneu_sysid.records.peek import Peeked, peek
from pneu_workbench.rig_fields import (
    Field,
    Keys,
    channels_of,
    checked,
    fields_of,
    with_number,
    with_value,
)
from pneu_workbench.schematic import schematic

PRESENT = "what is open, or the chosen file"
GAUGE = " above the room's"
"""A gauge shows 0 at the pressure of the room."""
OF_PART: dict[str, dict[str, float]] = {
    "commands": {"V": 1.0, "mV": 1e-3},
    "taps": dict(PRESSURES) | {f"{name}{GAUGE}": scale for name, scale in PRESSURES},
    "encoders": {"rad": 1.0, "degrees": math.pi / 180.0, "m": 1.0, "mm": 1e-3},
}
"""How much of the SI a unit is in which a channel may be recorded."""
AS_IT_IS = "as the file has it"
WIDE, HIGH = 160, 36


class Editor:
    """The form."""

    def __init__(
        self,
        begin: Callable[[], Path | None],
        recording: Callable[[], Path | None],
        use: Callable[[Rig, str], None],
        say: Callable[[str], None],
    ) -> None:
        """Builds it where it is called, empty as yet.

        Args:
            begin: Tells the rig file that is chosen; None is none.
            recording: Tells the recording whose channels are matched; None is none.
            use: Takes the rig, and what was changed in words.
            say: Says what is wrong.
        """
        self._begin, self._recording, self._use, self._say = begin, recording, use, say
        self._data: dict[str, Any] = {}
        self._path = Path()
        self._changes: dict[Keys, str] = {}
        self._faults: dict[Keys, str] = {}
        self._peeked: list[Peeked] = []
        self._rig: Rig | None = None
        self._room_pa, self._layout = math.nan, TextFormat()  # of what was valid last
        templates = {f"{kind}": f"new: {what}" for kind, what in kinds().items()}
        with ui.row().classes("w-full items-end"):
            self._from = ui.select(
                {PRESENT: PRESENT, **templates}, value=PRESENT, label="Begin from"
            )
            self._from.classes("grow min-w-[14rem]")
            ui.button("Edit", on_click=self._load).props("outline")
        self._form = ui.column().classes("w-full")

    def _load(self) -> None:
        """Fills the form."""
        kind = str(self._from.value)
        path = self._begin() if kind == PRESENT else TEMPLATES / f"{kind}.yaml"
        if path is None:
            self._say("rig file: none was chosen")
            return
        try:
            data = read_yaml(path, "rig file")
        except InputError as error:
            self._say(str(error))
            return
        rig, fault = checked(data, path)
        if rig is None:
            self._say(f"{path.name}: {fault}")
            return
        self._data, self._path, self._rig = data, path, rig
        self._changes, self._faults, self._peeked = {}, {}, []
        self._build()

    def _build(self) -> None:
        self._form.clear()
        parts: dict[str, list[Field]] = {}
        for field in fields_of(self._data):
            parts.setdefault(field.keys[0], []).append(field)
        with self._form:
            with ui.element("div").classes("pneu-scroll") as moved:
                moved.props('tabindex=0 role=group aria-label="Schematic, can be moved sideways"')
                self._drawing = ui.html("", sanitize=False).classes("w-full")
            self._wrong = ui.label().classes("text-negative").props("role=alert")
            for part, fields in parts.items():
                closed = ui.expansion(part).classes("w-full")
                with closed, ui.element("div").classes("pneu-fields"):
                    for field in fields:
                        self._number(field)
            with ui.expansion("channels of the recording").classes("w-full"):
                self._channels = ui.column().classes("w-full")
                with self._channels:
                    ui.button("Look into the recording", on_click=self._look).props("outline")
            with ui.row():
                self._done = ui.button("Use this rig", on_click=self._take)
        self._check()

    def _number(self, field: Field) -> None:
        unit = f", {field.unit}" if field.unit else ""
        entry = ui.input(f"{field.part}: {field.label}{unit}", value=field.text)
        entry.props("dense stack-label inputmode=decimal")

        def typed(event: Any) -> None:
            text = str(event.value)
            try:
                self._data = with_number(self._data, field, text)
                self._faults.pop(field.keys, None)
                self._changes[field.keys] = (
                    f"{field.part} {field.label} {text} {field.unit}".strip()
                )
                if text.strip() == field.text:
                    del self._changes[field.keys]
                    self._data = with_value(self._data, field.keys, field.value / field.scale)
            except InputError as error:
                self._faults[field.keys] = str(error)
            entry.error = self._faults.get(field.keys)
            self._check()

        entry.on_value_change(typed)

    def _check(self) -> None:
        """Says what is wrong with all of it together, and draws it."""
        rig, fault = checked(self._data, self._path)
        fault = next(iter(self._faults.values()), fault)
        self._wrong.set_text(fault)
        self._rig = None if fault else rig
        if rig is not None:
            self._room_pa = rig.ambient.pressure_pa
            self._layout = rig.text or TextFormat()
        if self._rig is not None:
            self._drawing.set_content(schematic(self._rig, None, None))
        self._done.set_enabled(self._rig is not None)

    async def _look(self) -> None:
        """Asks what numbers the recording has, in a process of its own."""
        path = self._recording()
        if path is None:
            self._say("recording: none was chosen")
            return
        try:
            self._peeked = await run.cpu_bound(peek, path, self._layout) or []
        except InputError as error:
            self._say(str(error))
            return
        self._channels.clear()
        with self._channels:
            for keys, words in channels_of(self._data):
                self._channel(keys, words)

    def _channel(self, keys: Keys, words: str) -> None:
        """A row: of what, from where, in which unit, and what that looks like."""
        named = {k: f"{one.topic or 'column'} {one.field}" for k, one in enumerate(self._peeked)}
        now = self._data[keys[0]][keys[1]].get("channel") or {}
        at = next((k for k, one in enumerate(self._peeked) if _is_of(one, now)), None)
        units = {AS_IT_IS: AS_IT_IS, **{unit: unit for unit in OF_PART[keys[0]]}}
        with ui.row().classes("w-full items-center"):
            ui.label(words).classes("min-w-[8rem]")
            source = ui.select(named, value=at, label=f"{words}: signal", with_input=True)
            source.classes("grow min-w-[14rem]").props("dense")
            unit = ui.select(units, value=AS_IT_IS, label=f"{words}: unit").props("dense")
            unit.classes("min-w-[7rem]")
            shown = ui.html("", sanitize=False)
            range_label = ui.label().classes("text-sm")

        def picked(_: Any = None) -> None:
            if source.value is None:
                return
            one = self._peeked[int(source.value)]
            channel = dict(self._data[keys[0]][keys[1]].get("channel") or {})
            if not _is_of(one, channel):
                gone = ("topic", "column", "field", "type", "applied")
                channel = {k: v for k, v in channel.items() if k not in gone}
                place = dict(topic=one.topic, field=one.field, type=one.type)
                channel |= place if one.topic else dict(column=one.field)
                self._changes[keys] = f"{words} from {one.topic} {one.field}".replace("  ", " ")
            if unit.value != AS_IT_IS:
                chosen = str(unit.value)
                channel["scale"] = OF_PART[keys[0]][chosen]
                channel["offset"] = self._room_pa if chosen.endswith(GAUGE) else 0.0
                self._changes[keys] = f"{words} from {one.topic} {one.field} in {unit.value}"
            self._data = with_value(self._data, keys, channel)
            shown.set_content(outline(one))
            scale, offset = channel.get("scale", 1.0), channel.get("offset", 0.0)
            low, high = (scale * x + offset for x in (one.least, one.most))
            if keys[0] == "taps":
                range_label.set_text(f"{low / 1e5:.3g} to {high / 1e5:.3g} bar absolute")
            else:
                range_label.set_text(f"{low:.3g} to {high:.3g}")
            self._check()

        source.on_value_change(picked)
        unit.on_value_change(picked)
        picked()

    def _take(self) -> None:
        if self._rig is None:
            return
        changes = list(self._changes.values())
        words = "; ".join(changes[:2]) + (f" and {len(changes) - 2} more" if changes[2:] else "")
        self._use(self._rig, words or f"{self._rig.name} as it is")


def outline(one: Peeked) -> str:
    """A small drawing of a signal.

    Args:
        one: The signal.
    """
    span = one.most - one.least
    points = [
        f"{WIDE * k / max(len(one.outline) - 1, 1):.1f},"
        f"{HIGH - 2 - (HIGH - 4) * ((v - one.least) / span if span > 0.0 else 0.5):.1f}"
        for k, v in enumerate(one.outline)
        if math.isfinite(v)
    ]
    name = escape(f"{one.topic} {one.field}", quote=True)
    return (
        f'<svg viewBox="0 0 {WIDE} {HIGH}" width="{WIDE}" height="{HIGH}" role="img"'
        f' aria-label="Outline of {name}"><polyline points="{" ".join(points)}" fill="none"'
        ' stroke="currentColor" stroke-width="1.2"/></svg>'
    )


def _is_of(one: Peeked, channel: dict[str, Any]) -> bool:
    """Whether a channel of a rig file is that signal."""
    if one.topic:
        return bool(channel.get("topic") == one.topic and channel.get("field", "data") == one.field)
    return channel.get("column") is not None and str(channel["column"]) == one.field
