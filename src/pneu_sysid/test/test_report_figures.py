# SPDX-License-Identifier: Apache-2.0
"""Every figure of the HTML report against the result that it comes from, by heading and row.

A cell that shows another number of the result, an inverted ratio, another sign or another unit
than its heading fails, since all numbers of the results differ.
"""

import base64
import functools
import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.distinct_results import BUILD, MODELS, TAPS, head, units_of
from tests.pages import Element, Table, check, check_with_error, read_page, read_table, shown

from pneu_sysid.report import write_report

pytestmark = pytest.mark.kernel_free

DRAWN = {"Pa": ("kPa", 1e-3), "rad": ("mrad", 1e3), "m": ("mm", 1e3)}
UNITS = {"m^2, effective": "m², effective", "m^3/(s Pa)": "m³/(s Pa)", "1": "", None: ""}


@functools.cache
def result(command: str, mixed: bool) -> dict[str, Any]:
    return BUILD[command](mixed).as_dict()


@pytest.fixture(scope="module")
def page_of(tmp_path_factory):
    """The pages of sets of commands, each made once."""

    @functools.cache
    def of(mixed: bool, *commands: str) -> Element:
        given = {name: result(name, mixed) for name in commands or BUILD}
        path: Path = write_report(tmp_path_factory.mktemp("report") / "r.html", **given)
        return read_page(path.read_text(encoding="utf-8"))

    return of


def sensors_of(given: Mapping[str, Any], key: str) -> dict[str, Any]:
    return {**given[f"{key}_pa"], **given[key]}


def floors_of(mixed: bool) -> dict[str, float]:
    return sensors_of(head(mixed), "noise_floor")


def drawn(sensor: str, mixed: bool, *texts: str) -> float:
    """The factor from SI to the unit that stands in one of the headings of a cell."""
    unit, scale = DRAWN[units_of(mixed)[sensor]]
    assert any(text.endswith(f", {unit}") for text in texts), f"{texts} without {unit}"
    return scale


def row_name(cell: Element | None) -> str:
    assert cell is not None
    return cell.text.strip()


def by_name(table: Table) -> Iterator[tuple[str, str, list[Element | None]]]:
    """Header text, sensor and cells of each row."""
    for row in table.rows:
        text = row_name(row[0])
        yield text, text.partition(",")[0], row


def text_at(table: Table, row: list[Element | None], *heading: str) -> str:
    return row_name(row[table.column(*heading)])


def headed(name: str, mixed: bool) -> str:
    return name if mixed else f"{name}, kPa"


def check_heat(page: Element, cell: Element, times: float | None) -> None:
    """Assert that the colour of a cell is that of its number in the legend of the page."""
    found = [c for c in cell.classes if re.fullmatch(r"h\d|h-none", c)]
    if times is None:
        assert found == ["h-none"]
        return
    steps = [s for s in page.every("span", "step")]
    edges = [(shown(s.text)[0], next(c for c in s.classes if c != "step")) for s in steps]
    assert all(s.text.startswith("≤") for s in steps[:-1]) and steps[-1].text.startswith(">")
    assert [e for e, _ in edges[:-1]] == sorted({e for e, _ in edges[:-1]})
    wanted = next((name for edge, name in edges[:-1] if times <= edge), edges[-1][1])
    assert found == [wanted], f"{times}: {cell.text}"


both = pytest.mark.parametrize("mixed", [False, True], ids=["taps", "with encoders"])


@both
def test_errors_per_sensor_and_model(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    section = page.section("errors")
    table = read_table(section.the("table"))
    floors = floors_of(mixed)
    models = {m["name"]: m for m in result("compare", mixed)["models"]}
    seen = set()
    for text, sensor, row in by_name(table):
        name_cell = row[table.column("Model")]
        assert name_cell is not None
        name = next(m for m in MODELS if name_cell.text.startswith(m))
        index = MODELS.index(name)
        assert f"m{index}" in name_cell.the("span", "swatch").classes
        times_cell = row[table.column("RMS over noise (log)")]
        assert times_cell is not None
        times = times_cell.the("span", "after").text
        seen.add((sensor, name))
        if sensor.startswith("all "):
            rms = None if mixed else 1e-3 * models[name]["rmse_pa"]
            cell = text_at(table, row, headed("RMS", mixed))
            assert cell == "" if mixed else check(cell, rms) is None
            check(times, models[name]["times_noise"])
            value = models[name]["times_noise"]
        else:
            p = "_pa" if sensor in TAPS else ""
            error = models[name]["taps" if p else "encoders"][sensor]

            def scaled(key: str, heading: str, text=text, sensor=sensor, error=error) -> float:
                return drawn(sensor, mixed, heading, text) * error[key]

            scale = drawn(sensor, mixed, headed("noise", mixed), text)
            check(text_at(table, row, headed("noise", mixed)), scale * floors[sensor])
            rms, bias = headed("RMS", mixed), headed("bias", mixed)
            check(text_at(table, row, rms), scaled(f"rmse{p}", rms))
            check(text_at(table, row, bias), scaled(f"bias{p}", bias))
            check(text_at(table, row, "RMS, atm"), error.get("rmse_atm"))
            share = text_at(table, row, "of signal std")
            check(share.removesuffix(" %"), 100.0 * error["normalised"])
            check(text_at(table, row, "lag, ms"), 1e3 * error["lag_s"])
            check(times, error["times_noise"])
            value = error["times_noise"]
        # the scale of the bars is logarithmic from one half, and the line is at the noise
        bar, limit = times_cell.the("rect"), times_cell.the("line", "limit")
        assert f"m{index}" in bar.classes
        at_noise = limit.number("x1")
        assert limit.number("x2") == at_noise
        length = at_noise * math.log(max(value, 0.51) / 0.5) / math.log(2.0)
        assert bar.number("x") == 0.0
        assert bar.number("width") == pytest.approx(length, abs=0.1 + 0.003 * length)
    names = [*units_of(mixed), "all sensors" if mixed else "all taps"]
    assert seen == {(sensor, model) for sensor in names for model in MODELS}
    assert "measured minus model" in section.the("caption").text
    assert "positive lag means that the measurement comes later" in section.the("caption").text


@both
def test_note_on_the_grid(page_of, mixed: bool) -> None:
    numerics = result("compare", mixed)["numerics"]
    change, floors = sensors_of(numerics, "change"), floors_of(mixed)
    most = max(change, key=lambda name: change[name] / floors[name])
    note = page_of(mixed).section("errors").the("p", "note").text
    words = re.search(r"Cells of (\S+) mm against (\S+) mm change .* by (\S+) (\w+) .* at (.*)\.",
                      note)  # fmt: skip
    assert words
    check(words[1], 1e3 * numerics["dx_m"])
    check(words[2], 1e3 * numerics["refined_dx_m"])
    unit, scale = DRAWN[units_of(mixed)[most]]
    assert (words[4], words[5]) == (unit, most)
    check(words[3], scale * change[most])


@both
def test_before_and_after(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    table = read_table(page.section("before-after").the("table"))
    steps = result("learn", mixed)["steps"]
    floors = floors_of(mixed)
    sensors = []
    for text, sensor, row in by_name(table):
        sensors.append(sensor)
        noise = headed("Sensor noise", mixed)
        scale = drawn(sensor, mixed, noise, text)
        check(text_at(table, row, noise), scale * floors[sensor])
        for part, key in (("Training", "rmse"), ("Held-out", "held_out_rmse")):
            values = [sensors_of(step, key)[sensor] for step in (steps[0], steps[-1])]
            for when, value in zip(("before", "after"), values, strict=True):
                heading = (part, headed(when, mixed))
                assert drawn(sensor, mixed, heading[1], text) == scale
                check(text_at(table, row, *heading), scale * value)
                # the column beside it has the same error over the noise
                cell = row[table.column(*heading) + 1]
                assert table.headings[table.column(*heading) + 1] == (part, "over noise")
                check(row_name(cell), value / floors[sensor])
                assert cell is not None
                check_heat(page, cell, value / floors[sensor])
            check(text_at(table, row, part, "falls by factor"), values[0] / values[1])
    assert sensors == list(units_of(mixed))


@both
def test_errors_after_each_step(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    table = read_table(page.section("waterfall").the("table"))
    caption = page.section("waterfall").the("caption").text
    steps = result("learn", mixed)["steps"]
    floors = floors_of(mixed)
    names = ["base model", "+ leak", "+ lag"]
    wanted = [
        (f"{name}, {part}", sensors_of(step, key))
        for name, step in zip(names, steps, strict=True)
        for part, key in (("training", "rmse"), ("held-out", "held_out_rmse"))
    ]
    assert [row_name(row[0]) for row in table.rows] == [name for name, _ in wanted]
    for row, (_, errors) in zip(table.rows, wanted, strict=True):
        for sensor, value in errors.items():
            unit, scale = DRAWN[units_of(mixed)[sensor]]
            assert mixed or caption.startswith(f"RMS error, {unit};")
            cell = row[table.column(f"{sensor}, {unit}" if mixed else sensor)]
            check(row_name(cell), scale * value)
            assert cell is not None
            check_heat(page, cell, value / floors[sensor])


def test_waterfall(page_of) -> None:
    """Bars against the ticks of their own axis; what rises is marked as worse."""
    section = page_of(False).section("waterfall")
    chart = section.the("svg", "chart")
    steps = result("learn", False)["steps"]
    ticks = {}
    for line, label in zip(
        chart.every("line", "grid"),
        [t for t in chart.every("text", "tick") if "end" in t.classes],
        strict=True,
    ):
        assert label.number("y") == pytest.approx(line.number("y1") + 4)
        ticks[float(label.text)] = line.number("y1")
    slope, at_one = np.polyfit(np.log(list(ticks)), list(ticks.values()), 1)
    assert slope < 0.0  # larger errors are higher on the page

    def height(level: float) -> float:
        return float(at_one + slope * math.log(level))

    assert chart.the("line", "floor").number("y1") == pytest.approx(height(1.0), abs=0.2)
    keys = {"train": "total_times_noise", "held": "held_out_times_noise"}
    words = section.the("p", "key").text
    swatches = [s.classes[-1] for s in section.the("p", "key").every("span", "swatch")]
    parts = [words.index("training"), words.index("held-out"), words.index("sensor noise")]
    assert swatches == ["train", "held", "floor"] and parts == sorted(parts)
    columns = []
    for name, key in keys.items():
        levels = [step[key] for step in steps]
        lines = list(chart.every("line", name))
        tops = [line for line in lines if "level" in line.classes]
        links = [line for line in lines if "link" in line.classes]
        drops = list(chart.every("rect", name))
        assert [t.number("y1") for t in tops] == pytest.approx([height(v) for v in levels], abs=0.2)
        assert all(line.number("y1") == line.number("y2") for line in lines)
        assert [t.number("x1") for t in tops] == sorted(t.number("x1") for t in tops)
        columns.append([t.number("x1") for t in tops])
        for before, after, link, drop, top in zip(
            levels[:-1], levels[1:], links, drops, tops[1:], strict=True
        ):
            assert ("worse" in drop.classes) == (after > before)
            ends = sorted((height(before), height(after)))
            assert drop.number("y") == pytest.approx(ends[0], abs=0.2)
            assert drop.number("height") == pytest.approx(ends[1] - ends[0], abs=0.2)
            assert drop.number("x") == top.number("x1")
            assert link.number("y1") == pytest.approx(height(before), abs=0.2)
            assert link.number("x2") == top.number("x1")
        for level, top in zip(levels, tops, strict=True):
            middle = 0.5 * (top.number("x1") + top.number("x2"))
            label = next(
                t
                for t in chart.every("text", "value")
                if t.number("x") == middle and abs(t.number("y") + 7 - top.number("y1")) < 0.2
            )
            check(label.text, level)
    # the labels of a step stand below its own bars
    for k, step in enumerate(steps):
        names = [
            t
            for t in chart.every("text", "middle")
            if "value" not in t.classes and columns[0][k] <= t.number("x") <= columns[1][k] + 64
        ]
        texts = [t.text for t in names]
        if step["added"] is None:
            assert texts == ["base model", "no effect added"]
        else:
            assert texts[:2] == [f"+ {step['added']}", f"@ {step['place']}"]
            scale, unit = (1e3, "ms") if step["unit"] == "s" else (1.0, "m²")
            check_with_error(texts[2], scale * step["strength"], scale * step["std_error"], unit)


@both
def test_map_of_regimes(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    table = read_table(page.section("residual-maps").the("table"))
    floors = floors_of(mixed)
    titles = {"flow_direction": "Flow direction", "pressure": "Pressure level",
              "frequency": "Frequency band"}  # fmt: skip
    rows: dict[tuple[str, str], list[Element | None]] = {}
    kind = ""
    for row in table.rows:
        if row_name(row[0]) in titles.values():
            kind = row_name(row[0])
        else:
            rows[kind, row_name(row[0])] = row
    assert list(rows) == [
        ("Flow direction", "filling"),
        ("Pressure level", "1-2 bar"),
        ("Pressure level", "2-3 bar"),
        ("Frequency band", "below 2 Hz"),
    ]
    count = 0
    for model in result("compare", mixed)["models"]:
        for regime in [*model["regimes"], *model["encoder_regimes"]]:
            p = "_pa" if "tap" in regime else ""
            sensor = regime["tap" if p else "encoder"]
            cell = rows[titles[regime["kind"]], regime["label"]][
                table.column(model["name"], sensor)
            ]
            assert cell is not None
            times = regime[f"rmse{p}"] / floors[sensor]
            check(cell.text, times)
            check_heat(page, cell, times)
            unit, scale = DRAWN[units_of(mixed)[sensor]]
            hint = re.fullmatch(
                rf"measured minus model: (\S+) {unit} RMS, (?:mean (\S+) {unit}, )?"
                r"(\S+) % of the sensor's squared error, (\d+) samples",
                cell.attributes["title"],
            )
            assert hint, cell.attributes["title"]
            check(hint[1], scale * regime[f"rmse{p}"])
            if regime[f"bias{p}"] is None:
                assert hint[2] is None
            else:
                check(hint[2], scale * regime[f"bias{p}"])
            check(hint[3], 100.0 * regime["share"])
            assert int(hint[4]) == regime["samples"]
            count += 1
    assert count == 2 * 4 * len(units_of(mixed))


@both
def test_map_over_time(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    series = result("compare", mixed)["series"]
    time_s = np.array(series["time_s"])
    measured = series["measured"] | series["measured_encoders"]
    floors = floors_of(mixed)
    figures = list(page.section("residual-maps").every("figure"))
    assert [f.the("figcaption").text for f in figures] == list(MODELS)
    seen = set()
    for figure, model in zip(figures, MODELS, strict=True):
        predicted = series["model"][model] | series["model_encoders"][model]
        rows = {t.number("y") - 14: t.text for t in figure.every("text", "end")}
        assert list(rows.values()) == list(units_of(mixed))
        begins = {}
        for rect in figure.every("rect"):
            sensor = rows[rect.number("y")]
            begin, end = (float(x) for x in rect.attributes["data-span"].split(","))
            begins[begin] = rect.number("x")
            inside = (time_s >= begin - 1e-6) & (time_s < end + (1e-6 if end >= 90 else -1e-6))
            off = np.array(measured[sensor], float) - np.array(predicted[sensor], float)
            off = off[inside & np.isfinite(off)]
            times = float(np.sqrt(np.mean(off**2))) / floors[sensor] if off.size else None
            check_heat(page, rect, times)
            seen.update(rect.classes)
        assert list(begins.values()) == sorted(begins.values())
        # the ticks of the time axis stand where the stretches begin
        ticks = [t for t in figure.every("text", "tick") if t.text.endswith(" s")]
        assert len(ticks) > 4
        for tick in ticks:
            at = float(tick.text.removesuffix(" s"))
            if at in begins:
                assert tick.number("x") == pytest.approx(begins[at], abs=0.1)
    assert seen == {"h-none", *(f"h{k}" for k in range(8))}


@both
def test_data_of_the_time_plot(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    block = next(s for s in page.every("script") if s.attributes.get("id") == "viewer-data")
    data = json.loads(block.text)
    series = result("compare", mixed)["series"]
    sensors, floors = units_of(mixed), floors_of(mixed)

    def unpacked(text: str, kind: str) -> list[float]:
        return np.frombuffer(base64.b64decode(text), kind).tolist()

    def given(values: list[float | None]) -> list[float]:
        # a time at which no sensor was read is left out
        read = [series["measured"] | series["measured_encoders"]][0]
        kept = [k for k in range(len(values)) if any(read[n][k] is not None for n in sensors)]
        return [math.nan if values[k] is None else values[k] for k in kept]

    assert data["taps"] == list(sensors)
    assert unpacked(data["time"], "<f8") == given(series["time_s"])
    measured = series["measured"] | series["measured_encoders"]
    for k, name in enumerate(sensors):
        unit, scale = DRAWN[sensors[name]]
        assert (data["unit"][k], data["scale"][k]) == (unit, scale)
        assert data["noise"][k] == floors[name]
        assert data["gap"][k] == series["gap_s"][name]
        own = unpacked(data["measured"][k], "<f4")
        assert own == pytest.approx(given(measured[name]), rel=1e-6, nan_ok=True)
        for model, name_of in zip(data["models"], MODELS, strict=True):
            assert model["name"] == name_of
            told = series["model"][name_of] | series["model_encoders"][name_of]
            own = unpacked(model["taps"][k], "<f4")
            assert own == pytest.approx(given(told[name]), rel=1e-6)
    for command in data["commands"]:
        own = unpacked(command["values"], "<f4")
        assert own == pytest.approx(given(series["command"][command["name"]]), rel=1e-6)
    assert [c["name"] for c in data["commands"]] == ["v1", "v2"]
    assert data["segments"] == [[0.0, 30.0], [31.5, 90.0]]
    boxes = [(b.attributes["data-kind"], b.attributes.get("data-index"), label.text)
             for label in page.section("overlay").every("label")
             for b in label.every("input")
             if b.attributes["data-kind"] != "logarithmic"]  # fmt: skip
    assert boxes == [
        *(("tap", str(k), name) for k, name in enumerate(sensors)),
        *(("model", str(k), name) for k, name in enumerate(MODELS)),
    ]


@both
def test_buttons_of_the_worst_stretches(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    floors = floors_of(mixed)
    stretches = {}
    for model in result("compare", mixed)["models"]:
        for sensor, error in [*model["taps"].items(), *model["encoders"].items()]:
            p = "_pa" if sensor in TAPS else ""
            for one in error["worst"]:
                # of pressures alone the error counts, beside angles its ratio to the noise
                size = one[f"rmse{p}"] / (floors[sensor] if mixed else 1.0)
                stretches[model["name"], one["start_s"]] = (size, sensor, one[f"rmse{p}"], one)
    shown_of: dict[str, list[float]] = {name: [] for name in MODELS}
    for button in page.section("overlay").every("button"):
        if button.attributes["data-span"] == "all":
            continue
        begin, end = (float(x) for x in button.attributes["data-span"].split(","))
        name = next(m for m in MODELS if button.text.startswith(f"{m}, "))
        size, sensor, rmse, one = stretches[name, begin]
        unit, scale = DRAWN[units_of(mixed)[sensor]]
        text = re.fullmatch(rf"{name}, {sensor}: (\S+) {unit} at (\S+)–(\S+) s", button.text)
        assert text, button.text
        check(text[1], scale * rmse)
        check(text[2], begin)
        check(text[3], end)
        assert end == one["end_s"]
        shown_of[name].append(size)
    for name, sizes in shown_of.items():
        every = sorted((s[0] for (model, _), s in stretches.items() if model == name), reverse=True)
        assert sizes == every[:3]


def test_ranking_of_candidates(page_of) -> None:
    section = page_of(False).section("ranking")
    ranking, depends = (read_table(t) for t in section.every("table"))
    candidates = result("diagnose", False)["candidates"]
    tested = [c for c in candidates if c["tested"]]
    key = section.the("p", "key")
    swatches = [s.classes[-1] for s in key.every("span", "swatch")]
    assert swatches == ["score", "refit", "held"]
    order = ["first order", "after a refit", "held-out"]
    assert [key.text.index(w) for w in order] == sorted(key.text.index(w) for w in order)
    for rank, (row, c) in enumerate(zip(ranking.rows, tested, strict=True), start=1):
        assert text_at(ranking, row, "#") == str(rank)
        name = text_at(ranking, row, "Effect and place")
        assert name.startswith(f"{c['effect']} @ {c['place']}") and name.endswith(c["title"])
        if c["position_m"] is not None:
            position = re.search(rf"{c['place']} (\S+) m", name)
            assert position
            check(position[1], c["position_m"])
        strength = row[ranking.column("Strength")]
        assert strength is not None
        small = c["unit"] == "s" and abs(c["strength"]) < 0.1
        scale, unit = (1e3, "ms") if small else (1.0, UNITS.get(c["unit"], c["unit"]))
        check_with_error(strength.text.strip(), scale * c["strength"], scale * c["std_error"], unit)
        check(text_at(ranking, row, "Strength over its error"), c["significance"], 0.1)
        words = text_at(ranking, row, "Look-alikes on this recording")
        assert ("Not told apart from: " in words) == bool(c["indistinguishable_from"])
        for text in [*c["indistinguishable_from"], c["next_experiment"]]:
            assert text in words
        assert ("Next experiment: " in words) == bool(c["next_experiment"])
        check_bars(row[ranking.column("Explains")], c)
        # whiskers: a dot at the strength, a line of two standard errors, and zero
        dot, zero = strength.the("circle"), strength.the("line", "zero").number("x1")
        span = strength.the("line", "interval")
        per = (span.number("x2") - span.number("x1")) / (4.0 * c["std_error"])
        assert per > 0.0
        rounding = 0.2 + 0.1 * abs(c["strength"]) / c["std_error"]
        assert dot.number("cx") - zero == pytest.approx(per * c["strength"], abs=rounding)
        middle = 0.5 * (span.number("x1") + span.number("x2"))
        assert dot.number("cx") == pytest.approx(middle, abs=0.15)
    entries = result("diagnose", False)["depends_on"]
    for row, entry in zip(depends.rows, entries, strict=True):
        assert text_at(depends, row, "Variable") == entry["variable"]
        assert text_at(depends, row, "Tap") == entry["tap"]
        cell = row[depends.column("Held-out gain")]
        assert cell is not None
        check(cell.the("span", "after").text, 100.0 * entry["gain"])
        assert cell.the("rect").number("width") == pytest.approx(190.0 * entry["gain"], abs=0.1)


def check_bars(cell: Element | None, candidate: Mapping[str, Any]) -> None:
    """Bars to the right of zero where a share is positive, to the left where it is negative."""
    assert cell is not None
    zero = cell.the("line", "zero").number("x1")
    keys = (("explained_fraction", "score", "first-order"), ("refit_fraction", "refit", "after"),
            ("held_out_gain", "held", "held-out gain"))  # fmt: skip
    texts = list(cell.every("text"))
    name = cell.the("svg").attributes["aria-label"].split(", ")
    widths = []
    for (key, kind, label), text, spoken in zip(keys, texts, name, strict=True):
        value = candidate[key]
        check(text.text.removeprefix(text.the("title").text), 100.0 * value)
        assert text.the("title").text.startswith(label) and spoken.startswith(label)
        check(re.sub(r"^\D+?(?=[−\d])", "", spoken), 100.0 * value)
        bar = cell.the("rect", kind)
        assert 0.0 < text.number("y") - bar.number("y") < bar.number("height")
        side = bar.number("x") - zero
        widths.append((bar.number("width"), abs(value)))
        if value > 0.0:
            assert side == pytest.approx(0.0, abs=0.06)
        else:
            assert side == pytest.approx(-bar.number("width"), abs=0.06)
            # what would leave the margin is cut there
            assert side >= -zero - 0.06
    per = widths[0][0] / widths[0][1]
    for (width, size), (key, _, _) in zip(widths, keys, strict=True):
        cut = zero if candidate[key] < 0.0 else math.inf
        assert width == pytest.approx(min(per * size, cut), abs=0.5)


def test_experiments(page_of) -> None:
    section = page_of(False).section("experiments")
    table = read_table(section.the("table"))
    wanted = [
        (one, pair)
        for one in result("learn", False)["experiments"]
        for pair in one["told_apart"] or [None]
    ]
    for row, (one, pair) in zip(table.rows, wanted, strict=True):
        name = text_at(table, row, "Experiment")
        text = re.fullmatch(rf"{Path(one['plan']).name} {one['kind']}, (\S+) s", name)
        assert text, name
        check(text[1], one["seconds"])
        if pair is None:
            assert "first look" in row_name(row[1])
            continue
        assert text_at(table, row, "was to tell") == f"{pair['one']} from {pair['other']}"
        for key in ("expected", "found", "needed"):
            check(text_at(table, row, key), pair[key])
        picture = row[-1]
        assert picture is not None
        # rails: the axis and its zero; the tick is what is needed, as the caption says
        zero = min(picture.every("line", "rail"), key=lambda r: r.number("y2") - 100 * (
            r.number("x1") == r.number("x2"))).number("x1")  # fmt: skip
        tick = picture.the("line", "zero").number("x1")
        per = (tick - zero) / pair["needed"]
        assert per > 0.0
        expected = picture.the("circle", "hollow").number("cx")
        assert expected - zero == pytest.approx(per * pair["expected"], abs=0.3)
        dots = list(picture.every("circle", "dot"))
        assert len(dots) == (pair["found"] is not None)
        for dot in dots:
            assert dot.number("cx") - zero == pytest.approx(per * pair["found"], abs=0.3)
    caption = section.the("caption").text
    assert "dot is what was found, the hollow one what was expected, the tick what is" in caption


def test_fitted_parameters(page_of) -> None:
    section = page_of(False).section("fit")
    tables = [read_table(t) for t in section.every("table")]
    table, correlations = tables[0], tables[1]
    parameters = result("fit", False)["parameters"]
    for row, p in zip(table.rows, parameters, strict=True):
        assert text_at(table, row, "Parameter") == p["path"]
        small = p["unit"] == "s" and abs(p["value"]) < 0.1
        scale, unit = (1e3, "ms") if small else (1.0, UNITS.get(p["unit"], p["unit"]))
        error = None if p["std_error"] is None else scale * p["std_error"]
        check_with_error(
            text_at(table, row, "Value ± standard error"), scale * p["value"], error, unit
        )
        relative = text_at(table, row, "relative").removesuffix(" %")
        share = None if error is None else 100.0 * p["std_error"] / abs(p["value"])
        check(relative, share)
        expected = re.fullmatch(r"(\S+) \((\S+) to (\S+)\)", text_at(table, row, "error expected"))
        assert expected
        check(expected[1], p["expected_error"])
        for k in (0, 1):
            check(expected[2 + k], p["expected_range"][k])
        check(text_at(table, row, "start"), p["start"])
        badges = row_name(row[-1])
        marks = {"at its bound": p["at_bound"], "held": p["held"],
                 "not identified": not p["identified"] and not p["held"]}  # fmt: skip
        assert badges == "".join(words for words, holds in marks.items() if holds)
        picture = row[table.column("between its bounds")]
        assert picture is not None
        low, high = (s for s in picture.the("title").text.split(" to "))
        check(low, p["lower"])
        check(high, p["upper"])
        rail = picture.the("line", "rail")
        begin, end = rail.number("x1"), rail.number("x2")
        span = p["upper"] - p["lower"]
        for at, value in ((picture.the("circle", "dot").number("cx"), p["value"]),
                          (picture.the("line", "zero").number("x1"), p["start"])):  # fmt: skip
            share = (value - p["lower"]) / span
            assert at == pytest.approx(begin + share * (end - begin), abs=0.06)
    assert "tick is the start, the dot the fitted value" in section.every("caption").__next__().text
    pairs = {frozenset((c["a"], c["b"])): c["value"] for c in result("fit", False)["correlations"]}
    names = [row_name(row[0]).partition("  ")[2] for row in correlations.rows]
    assert sorted(names) == sorted({n for pair in pairs for n in pair})
    for i, row in enumerate(correlations.rows):
        assert row_name(row[0]).startswith(f"{i + 1} ")
        for k in range(i):
            cell = row[correlations.column(str(k + 1))]
            assert cell is not None
            value = pairs.get(frozenset((names[i], names[k])))
            if value is None:
                assert cell.text == "·"
                continue
            check(cell.text, value)
            size = 3 if abs(value) >= 0.99 else 2 if abs(value) >= 0.95 else 1
            assert f"{'pos' if value > 0 else 'neg'}{size}" in cell.classes
    fit = result("fit", False)
    note = section.the("p", "note").text
    said = re.fullmatch(r"Condition number (\S+)\. Cost (\S+) → (\S+) in (\d+) iterations\.", note)
    assert said, note
    check(said[1], fit["condition"])
    check(said[2], fit["history"][0])
    check(said[3], fit["history"][-1])
    assert int(said[4]) == 3


@both
def test_errors_of_the_fit(page_of, mixed: bool) -> None:
    page = page_of(mixed)
    table = read_table(list(page.section("fit").every("table"))[-1])
    fit, floors = result("fit", mixed), floors_of(mixed)
    sensors = []
    for text, sensor, row in by_name(table):
        sensors.append(sensor)
        for name, key in (("training", "rmse"), ("held-out", "held_out_rmse")):
            heading = headed(name, mixed)
            value = sensors_of(fit, key)[sensor]
            check(text_at(table, row, heading), drawn(sensor, mixed, heading, text) * value)
            k = table.column(heading) + 1
            assert table.headings[k] == ("over noise",)
            check(row_name(row[k]), value / floors[sensor])
            cell = row[k]
            assert cell is not None
            check_heat(page, cell, value / floors[sensor])
    assert sensors == list(units_of(mixed))


def tiles(page: Element) -> dict[str, Element]:
    return {t.the("p", "label").text: t for t in page.section("verdict").every("div", "tile")}


@both
def test_tiles_of_what_was_learnt(page_of, mixed: bool) -> None:
    found = tiles(page_of(mixed))
    steps = result("learn", mixed)["steps"]
    for words, key in (("held-out", "held_out_times_noise"), ("training", "total_times_noise")):
        tile = found[f"{words} error over sensor noise"]
        check(tile.the("span", "was").text, steps[0][key])
        check(tile.the("span", "is").text, steps[-1][key])
        value = tile.the("p", "value").text
        assert value.index(tile.the("span", "was").text) < value.index("→")
    for step in steps[1:]:
        tile = found[f"{step['added']} @ {step['place']}"]
        scale, unit = (1e3, "ms") if step["unit"] == "s" else (1.0, "m²")
        text = tile.the("p", "value").text
        check_with_error(text, scale * step["strength"], scale * step["std_error"], unit)


@both
def test_tiles_of_a_diagnosis_and_a_comparison(page_of, mixed: bool) -> None:
    page = page_of(mixed, "diagnose", "compare")
    found = tiles(page)
    best = result("diagnose", mixed)["candidates"][0]
    text = found[f"{best['effect']} @ {best['place']}"].the("p", "value").text
    check_with_error(text, best["strength"], best["std_error"], "m²")
    share = found[f"of the excess error explained by {best['effect']}"].the("p", "value").text
    check(share.removesuffix(" %"), 100.0 * best["refit_fraction"])
    for model in result("compare", mixed)["models"]:
        tile = found[f"{model['name']}: error over sensor noise"]
        check(tile.the("p", "value").text, model["times_noise"])
        note = tile.the("p", "note").text
        value, _, words = note.partition(" kPa RMS")
        check(value, 1e-3 * model["rmse_pa"])
        assert words == (" at the taps" if mixed else "")
    sources = page.section("verdict").the("dl")
    told = dict(
        zip((t.text for t in sources.every("dt")), (d.text for d in sources.every("dd")),
            strict=True)
    )  # fmt: skip
    assert told["Taps"] == ", ".join(TAPS) and told["Recording"] == "run 3"
    floors, parts = floors_of(mixed), told["Sensor noise"].split(", ")
    for part, (unit, scale) in zip(
        parts, [("Pa", 1.0), *([("mrad", 1e3), ("mm", 1e3)] if mixed else [])], strict=True
    ):
        si = {"Pa": "Pa", "mrad": "rad", "mm": "m"}[unit]
        own = [scale * f for n, f in floors.items() if units_of(mixed)[n] == si]
        assert part.endswith(f" {unit}")
        ends = part.removesuffix(f" {unit}").split(" to ")
        assert len(ends) == (2 if len(own) > 1 else 1)
        for text, value in zip(ends, (min(own), max(own)), strict=False):
            check(text, value)


def test_tiles_of_a_fit(page_of) -> None:
    found = tiles(page_of(False, "fit"))
    fit = result("fit", False)
    assert found["fitted parameters"].the("p", "value").text == "4"  # one of five is held
    check(found["condition number"].the("p", "value").text, fit["condition"])
    sentence = page_of(False, "fit").section("verdict").the("p", "sentence").text
    assert sentence == "3 of 4 fitted parameters are identified by this recording."


def test_sentence_of_a_comparison(page_of) -> None:
    """Without a verdict the models are named, the best first, each with its own figure."""
    sentence = page_of(False, "compare").section("verdict").the("p", "sentence").text
    models = sorted(result("compare", False)["models"], key=lambda m: m["times_noise"])
    said = re.fullmatch(
        rf"{models[0]['name']} errs by (\S+) the sensor noise, {models[1]['name']} by (\S+)\.",
        sentence,
    )
    assert said, sentence
    for k, model in enumerate(models):
        check(said[1 + k], model["times_noise"])


@pytest.mark.parametrize(
    ("verdict", "mark", "words"),
    [
        ("nothing_missing", "✓", "Nothing is missing"),
        ("effect", "➤", "A missing effect was found"),
        ("ambiguous", "≈", "Several effects explain it equally well"),
        ("unknown", "?", "Something is missing that the catalogue does not hold"),
    ],
)
def test_card_of_each_verdict(tmp_path: Path, verdict: str, mark: str, words: str) -> None:
    given = result("diagnose", False) | {"verdict": verdict, "sentence": f"Said of {verdict}."}
    page = read_page(write_report(tmp_path / "r.html", diagnose=given).read_text())
    card = page.the("div", "card")
    assert verdict in card.classes
    assert card.the("p", "word").text == f"{mark}{words}"
    assert card.the("p", "sentence").text == f"Said of {verdict}."
    notes = [n.text for n in card.every("p", "note")]
    assert notes == ["Something changed.", "The model leaves much."]
    # a candidate is shown as the answer only where the verdict is that there is one
    assert ("best candidate" in page.text) == (verdict in ("effect", "ambiguous"))


def test_caveats_name_what_was_not_tested(tmp_path: Path, page_of) -> None:
    text = page_of(False).section("caveats").text
    assert "not tested on this recording: drag @ tube." in text
    weak = [p["path"] for p in result("fit", False)["parameters"] if not p["identified"]]
    assert f"does not determine {', '.join(weak)};" in text
    given = result("compare", False)
    floors = given["noise_floor_pa"] | {"valve_out": None}
    path = write_report(tmp_path / "r.html", compare=given | {"noise_floor_pa": floors})
    page = read_page(path.read_text())
    caveats = page.section("caveats").text
    assert "sensor noise of valve_out is not known" in caveats
    assert "No candidate effect was tested" in caveats
