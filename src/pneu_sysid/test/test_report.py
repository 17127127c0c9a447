# SPDX-License-Identifier: Apache-2.0
"""The HTML report: safe whatever the names, self-contained, and alive in a real browser."""

import base64
import copy
import json
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from tests.browsers import BROWSER, WITHOUT

from pneu_common.errors import InputError
from pneu_sysid.report import quantities, write_report

TAPS = ("supply", "valve_out", "middle", "end", "exhaust")
HOSTILE = "</script><img src=x onerror=\"document.title='owned'\"><!--"
MAX_BYTES = 3_000_000


# ---- Results as the commands give them, from first-order responses with known errors


def low_pass(values: np.ndarray, tau_s: float, dt_s: float) -> np.ndarray:
    share = 1.0 - np.exp(-dt_s / tau_s)
    start = [(1.0 - share) * values[0]]
    return lfilter([share], [1.0, share - 1.0], values, zi=start)[0]


def head(command: str, taps: tuple[str, ...] = TAPS) -> dict:
    return {
        "schema": f"pneu.{command}/1",
        "pneu_version": "0.1.0",
        "recording": "a_hidden_3",
        "rigs": ["rig_a"],
        "taps": list(taps),
        "noise_floor_pa": {tap: 260.0 + 15.0 * i for i, tap in enumerate(taps)},
        "findings": [
            "/taps/end/pressure: 14 of 6000 samples missing in 3 gaps, longest 8 ms; left out.",
            "/valve/voltage: 2 duplicated stamps; the later sample kept.",
        ],
    }


def compare_result(taps: tuple[str, ...] = TAPS, samples: int = 6000) -> dict:
    rng = np.random.default_rng(7)
    result = head("compare", taps)
    floors = result["noise_floor_pa"]
    time_s = np.linspace(0.0, 15.0, samples)
    dt_s = time_s[1]
    volts = np.repeat(rng.choice([2.0, 4.2, 5.0, 5.6, 6.5, 8.5], 40), -(-samples // 40))[:samples]
    volts = volts + 0.6 * np.sin(2 * np.pi * (0.5 + 0.5 * time_s) * time_s) * (time_s > 9)
    drive = low_pass(101e3 + 534e3 * np.clip((volts - 2.0) / 6.5, 0, 1), 0.08, dt_s)
    true, models = {}, {"pde, as given": {}, "pde + leak": {}, "thin plate": {}}
    for i, tap in enumerate(taps):
        clean = low_pass(drive, 0.03 + 0.05 * i, dt_s)
        leaked = clean - 0.025 * (clean - 101e3)
        true[tap] = leaked + floors[tap] * rng.standard_normal(samples)
        models["pde, as given"][tap] = clean
        models["pde + leak"][tap] = leaked + 0.0012 * (low_pass(leaked, 0.004, dt_s) - leaked)
        models["thin plate"][tap] = low_pass(clean, 0.05, dt_s)
    true[taps[-1]][2000:2060] = np.nan

    entries = []
    for name, predicted in models.items():
        residual = {tap: true[tap] - predicted[tap] for tap in taps}
        rmse = {tap: float(np.sqrt(np.nanmean(residual[tap] ** 2))) for tap in taps}
        windows = range(0, samples - samples // 30, samples // 30)
        regimes, per_tap = [], {}
        for tap in taps:
            total = float(np.nansum(residual[tap] ** 2))

            def regime(kind, label, mask, tap=tap, total=total, residual=residual):
                part = residual[tap][mask & np.isfinite(residual[tap])]
                return {
                    "kind": kind,
                    "label": label,
                    "tap": tap,
                    "rmse_pa": float(np.sqrt(np.mean(part**2))) if part.size else None,
                    "share": float(np.sum(part**2) / total),
                    "samples": int(part.size),
                }

            level = true[tap]
            regimes += [
                regime("flow_direction", "filling", volts > 5.05),
                regime("flow_direction", "exhausting", volts < 4.95),
                regime("flow_direction", "closed", np.abs(volts - 5.0) <= 0.05),
                regime("choked", "choked", np.abs(volts - 5.0) > 2.0),
                regime("choked", "subsonic", np.abs(volts - 5.0) <= 2.0),
                *(
                    regime("pressure", f"{a} to {b} kPa", (level > 1e3 * a) & (level <= 1e3 * b))
                    for a, b in ((80, 200), (200, 350), (350, 500), (500, 700))
                ),
                regime("frequency", "0 to 5 Hz", time_s < 11),
                regime("frequency", "5 to 50 Hz", time_s >= 11),
            ]
            worst = sorted(
                (
                    {
                        "start_s": float(time_s[k]),
                        "end_s": float(time_s[k + samples // 30]),
                        "rmse_pa": float(
                            np.sqrt(np.nanmean(residual[tap][k : k + samples // 30] ** 2))
                        ),
                    }
                    for k in windows
                ),
                key=lambda stretch: -stretch["rmse_pa"],
            )[:3]
            per_tap[tap] = {
                "rmse_pa": rmse[tap],
                "rmse_atm": rmse[tap] / 101325.0,
                "normalised": rmse[tap] / float(np.nanstd(true[tap])),
                "times_noise": rmse[tap] / floors[tap],
                "bias_pa": float(np.nanmean(residual[tap])),
                "lag_s": 0.05 if name == "thin plate" else 0.0004,
                "noise_floor_pa": floors[tap],
                "worst": worst,
            }
        ratios = np.array([rmse[tap] / floors[tap] for tap in taps])
        entries.append(
            {
                "name": name,
                "model": "thin_plate" if name == "thin plate" else "pde",
                "file": "rigs/rig_a.yaml",
                "taps": per_tap,
                "regimes": sorted(regimes, key=lambda r: -(r["rmse_pa"] or 0.0)),
                "rmse_pa": float(np.sqrt(np.mean(np.square(list(rmse.values()))))),
                "times_noise": float(np.sqrt(np.mean(ratios**2))),
            }
        )

    def listed(values):
        return [None if not np.isfinite(v) else float(v) for v in values]

    result["models"] = entries
    result["numerics"] = {
        "dx_m": 0.05,
        "refined_dx_m": 0.025,
        "change_pa": {tap: 60.0 for tap in taps},
        "discretisation": False,
        "sentence": "The grid changes no tap by more than a quarter of its sensor noise.",
    }
    result["series"] = {
        "time_s": listed(time_s),
        "command": {"voltage": listed(volts)},
        "measured": {tap: listed(true[tap]) for tap in taps},
        "model": {n: {t: listed(v) for t, v in p.items()} for n, p in models.items()},
        "gap_s": {tap: 3.5 * dt_s for tap in taps},
        "begins_s": [0.0],
        "segments": [[0.5 * k, 0.5 * (k + 1)] for k in range(30)],
    }
    return result


def read_in_turn(result: dict, turns: int = 2) -> dict:
    """The same result of sensors that are read one after the other: at each time only some."""
    series = result["series"]
    for i, tap in enumerate(result["taps"]):
        for values in (series["measured"], *series["model"].values()):
            values[tap] = [v if k % turns == i % turns else None for k, v in enumerate(values[tap])]
        series["gap_s"][tap] *= turns
    return result


def fit_result() -> dict:
    def parameter(path, value, start, error, unit, lower, upper, **marks):
        return {
            "path": path,
            "value": value,
            "start": start,
            "std_error": error,
            "unit": unit,
            "lower": lower,
            "upper": upper,
            "at_bound": marks.get("at_bound", False),
            "identified": marks.get("identified", True),
            "held": marks.get("held", False),
        }

    supply = "valves.valve.ports.supply"
    exhaust = "valves.valve.ports.exhaust"
    c_unit = "m^3/(s Pa)"
    return head("fit") | {
        "rig": "rig_a",
        "output": "fitted.yaml",
        "parameters": [
            parameter(f"{supply}.conductance_m3_s_pa", 9.31e-9, 9e-9, 4e-11, c_unit, 1e-9, 3e-8),
            parameter(f"{exhaust}.conductance_m3_s_pa", 1.04e-8, 1e-8, 6e-11, c_unit, 1e-9, 3e-8),
            parameter(f"{supply}.critical_ratio", 0.281, 0.3, 0.006, "1", 0.05, 0.6),
            parameter("pipes.tube.area_m2", 6.02e-6, 6e-6, 2e-8, "m^2", 3e-6, 1.2e-5),
            parameter("pipes.tube.friction_gain", 3.0, 1.0, 0.4, None, 0.0, 3.0, at_bound=True),
            parameter("pipes.exhaust_tube.heat_gain", 0.9, 1.0, 2.3, None, 0, 5, identified=False),
            parameter("valves.valve.spool.bandwidth_hz", 57.4, 60.0, 1.2, "Hz", 10.0, 200.0),
            parameter(
                "chambers.bottle.volume_m3",
                2e-4,
                2e-4,
                None,
                "m^3",
                5e-5,
                8e-4,
                identified=False,
                held=True,
            ),
        ],
        "shortfall": {
            "times_noise": {"end": 2.4},
            "sentence": "The calibration stops short: where it has not been fitted it is to be"
            " expected to leave more than 2 times the noise at end 2.4 (times).",
            "where": ["end: most with valve above 50 % open (4.7 times, 53 % of it)"],
            "help": ["sensor_lag@end would explain 61 % of it (about 8.1 ms): see `pneu diagnose`"],
        },
        "correlations": [
            {"a": "pipes.tube.area_m2", "b": f"{supply}.conductance_m3_s_pa", "value": 0.953},
            {
                "a": f"{supply}.conductance_m3_s_pa",
                "b": f"{supply}.critical_ratio",
                "value": -0.991,
            },
        ],
        "condition": 3.4e5,
        "warnings": [
            "pipes.exhaust_tube.heat_gain is not identified: its standard error is 2.6 times its "
            "value.",
            "pipes.tube.friction_gain stopped at its upper bound of 3.",
        ],
        "rmse_pa": {tap: 700.0 + 300 * i for i, tap in enumerate(TAPS)},
        "held_out_rmse_pa": {tap: 760.0 + 310 * i for i, tap in enumerate(TAPS)},
        "history": [41.0, 12.0, 8.7, 8.41, 8.409],
    }


def diagnose_result() -> dict:
    def candidate(effect, title, place, strength, unit, error, explained, refit, held, **more):
        return {
            "effect": effect,
            "title": title,
            "place": place,
            "position_m": more.get("position_m"),
            "strength": strength,
            "unit": unit,
            "std_error": error,
            "explained_fraction": explained,
            "refit_fraction": refit,
            "held_out_gain": held,
            "significance": None if not error else strength / error,
            "indistinguishable_from": more.get("mates", []),
            "next_experiment": more.get("experiment"),
            "tested": more.get("tested", True),
        }

    return head("diagnose") | {
        "verdict": "effect",
        "sentence": "Missing: a leak of the tube at 2.5 m; it explains 94 % of the excess error, "
        "and the held-out error falls from 5.6 to 1.1 times the sensor noise.",
        "rmse_pa": {tap: 2900.0 for tap in TAPS},
        "candidates": [
            candidate(
                "leak", "leak of a line to the room", "tube", 1.612e-8, "m^2, effective", 2.3e-10,
                0.941, 0.952, 0.936, position_m=2.48, mates=["spool_leakage @ valve.exhaust"],
                experiment="Close the valve on a full line and watch it empty: a leak empties the "
                "line with the valve at its null, spool leakage stops when the valve is capped.",
            ),
            candidate("spool_leakage", "leakage past the closed spool", "valve.exhaust", 0.0031,
                      "of the full opening", 0.0004, 0.88, 0.71, 0.55, mates=["leak @ tube"]),
            candidate("supply_level", "supply set to another pressure", "supply", -8210.0, "Pa",
                      950.0, 0.61, 0.42, 0.12),
            candidate("sensor_gain", "sensor scale off", "end", -0.021, "relative", 0.006, 0.33,
                      0.2, -0.04),
            candidate("valve_delay", "valve transport delay", "valve", 1.1e-4, "s", 2.4e-4, 0.02,
                      0.02, -0.31),
            *(
                candidate(f"weak_{i}", "one that explains nothing", "tube", 1e-3 * i, "1", 1e-2,
                          0.01, None, None)
                for i in range(8)
            ),
            candidate("chamber_leak", "leak of a chamber", "none", None, None, None, None, None,
                      None, tested=False),
        ],
        "depends_on": [],
        "numerics": {},
    }  # fmt: skip


def learn_result() -> dict:
    floors = head("learn")["noise_floor_pa"]

    def step(number, added, place, strength, unit, error, train, held):
        return {
            "step": number,
            "added": added,
            "place": place,
            "strength": strength,
            "unit": unit,
            "std_error": error,
            "rmse_pa": {tap: train * floor for tap, floor in floors.items()},
            "held_out_rmse_pa": {tap: held * floor for tap, floor in floors.items()},
            "total_times_noise": train,
            "held_out_times_noise": held,
        }

    return head("learn") | {
        "steps": [
            step(0, None, None, None, None, None, 21.4, 23.9),
            step(1, "leak", "tube", 1.612e-8, "m^2, effective", 2.3e-10, 3.12, 3.55),
            step(2, "valve_delay", "valve", 0.00251, "s", 0.00012, 1.04, 1.11),
        ],
        "verdict": "nothing_missing",
        "sentence": "Added a leak of the tube at 2.48 m and a valve delay of 2.5 ms; after that "
        "nothing more is missing: the held-out error is 1.1 times the sensor noise.",
        "output": "out/learned.yaml",
    }


def everything() -> dict:
    return {
        "compare": compare_result(),
        "fit": fit_result(),
        "diagnose": diagnose_result(),
        "learn": learn_result(),
    }


def renamed(value, old: str, new: str):
    """The same result with one name replaced wherever it stands, keys included."""
    if isinstance(value, dict):
        return {renamed(k, old, new): renamed(v, old, new) for k, v in value.items()}
    if isinstance(value, list):
        return [renamed(item, old, new) for item in value]
    return new if value == old else value


def emptied(value):
    """The same result with every number and text below the head replaced by null."""
    if isinstance(value, dict):
        return {key: emptied(item) for key, item in value.items()}
    if isinstance(value, list):
        return [emptied(item) for item in value]
    return None


# ---- Reading a page as a browser does


class Page(HTMLParser):
    """Elements, their attributes and the text outside script and style."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._raw = False
        self.feed(path.read_text(encoding="utf-8"))
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self._raw = tag in ("script", "style")

    def handle_endtag(self, tag):
        self._raw = False

    def handle_data(self, data):
        self.text += "" if self._raw else data

    def sections(self) -> list[str]:
        return [attributes["id"] for tag, attributes in self.elements if tag == "section"]


ALL_SECTIONS = [
    "verdict",
    "before-after",
    "waterfall",
    "errors",
    "overlay",
    "residual-maps",
    "ranking",
    "fit",
    "findings",
    "caveats",
]


def test_all_results_give_all_sections_with_their_figures(tmp_path):
    page = Page(write_report(tmp_path / "r.html", **everything(), title="Rig A, hidden 3"))
    assert page.sections() == ALL_SECTIONS
    for text in (
        "Rig A, hidden 3",
        "nothing more is missing",
        "(1.612 ± 0.023)×10⁻⁸ m², effective",
        "2.51 ± 0.12 ms",
        "Not told apart from: spool_leakage @ valve.exhaust",
        "Close the valve on a full line",
        "+0.953",
        "−0.991",
        "at its bound",
        "14 of 6000 samples missing",
        "chamber_leak @ none",
    ):
        assert text in page.text, text


@pytest.mark.parametrize(
    ("given", "sections"),
    [
        (["compare"], ["verdict", "errors", "overlay", "residual-maps", "findings", "caveats"]),
        (["fit"], ["verdict", "fit", "findings", "caveats"]),
        (["diagnose"], ["verdict", "ranking", "findings", "caveats"]),
        (["learn"], ["verdict", "before-after", "waterfall", "findings", "caveats"]),
    ],
)
def test_sections_without_a_result_are_left_out(tmp_path, given, sections):
    results = {name: result for name, result in everything().items() if name in given}
    assert Page(write_report(tmp_path / "r.html", **results)).sections() == sections


def experiment(**more) -> dict:
    pair = {"one": "leak@tube:1.50", "other": "spool_leakage@valve.exhaust", "needed": 3.0}
    return {
        "plan": "out/experiment_1.json",
        "kind": "separate",
        "seconds": 10.0,
        "told_apart": [pair | {"expected": 5.82, "found": 4.31} | more],
        "words": ["10 s cannot tell <b>leak</b> from chamber_leak."],
    }


def test_experiments_stand_with_what_they_were_to_tell_and_what_they_told(tmp_path):
    first = experiment() | {"kind": "steps", "told_apart": [], "words": []}
    learned = learn_result() | {"experiments": [first, experiment(), experiment(found=None)]}
    page = Page(write_report(tmp_path / "r.html", learn=learned))
    assert "experiments" in page.sections()
    for text in ("experiment_1.json", "separate, 10", "5.82", "4.31", "cannot tell <b>leak</b>"):
        assert text in page.text, text
    drawn = [a["aria-label"] for t, a in page.elements if t == "svg" and "needed" in str(a)]
    assert drawn == [f"expected 5.82, found {found}, needed 3.00" for found in ("4.31", "–")]


def test_errors_that_a_plan_promised_stand_beside_those_that_were_found(tmp_path):
    fit = fit_result()
    assert "error expected" not in Page(write_report(tmp_path / "a.html", fit=fit)).text
    fit["parameters"][0]["expected_error"] = 0.0123
    page = Page(write_report(tmp_path / "b.html", fit=fit))
    assert "error expected" in page.text and "0.0123" in page.text
    fit["parameters"][0]["expected_range"] = [0.0045, 0.678]
    assert "0.0123 (0.00450 to 0.678)" in Page(write_report(tmp_path / "c.html", fit=fit)).text


def test_the_page_loads_nothing_and_lets_only_its_own_script_run(tmp_path):
    path = write_report(tmp_path / "r.html", **everything())
    page = Page(path)
    assert path.stat().st_size < MAX_BYTES
    names = {tag for tag, _ in page.elements}
    assert not names & {"link", "img", "iframe", "object", "embed", "base", "audio", "video"}
    for tag, attributes in page.elements:
        assert "src" not in attributes, (tag, attributes)
        assert (attributes.get("href") or "#").startswith("#"), (tag, attributes)
        assert not [a for a in attributes if a.startswith("on")], (tag, attributes)
    assert not re.search(r"https?://|@import|url\(", path.read_text(encoding="utf-8"))
    policies = [a["content"] for t, a in page.elements if "content-security" in str(a).lower()]
    assert "default-src 'none'" in policies[0]
    assert "'unsafe-inline'" not in policies[0].partition("script-src")[2].partition(";")[0]


def test_hostile_names_stay_text(tmp_path):
    results = everything()
    for name in ("end", "pde + leak", "leak", "tube", "voltage", "a_hidden_3"):
        results = renamed(results, name, HOSTILE + name)
    for result in results.values():
        result["findings"].append(HOSTILE)
    results["diagnose"]["verdict"] = HOSTILE
    page = Page(write_report(tmp_path / "r.html", **results, title=HOSTILE))
    assert HOSTILE in page.text
    assert "img" not in {tag for tag, _ in page.elements}
    assert sum(tag == "script" for tag, _ in page.elements) == 2


def test_nulls_and_non_finite_numbers_make_a_page(tmp_path):
    results = everything()
    hollow = {
        name: emptied(result) | {"schema": result["schema"], "taps": list(TAPS)}
        for name, result in results.items()
    }
    hollow["compare"]["series"] = None
    hollow["fit"]["history"] = None
    assert Page(write_report(tmp_path / "hollow.html", **hollow)).sections()[0] == "verdict"

    results["compare"]["models"][0]["taps"]["end"]["rmse_pa"] = float("nan")
    results["learn"]["steps"][0]["total_times_noise"] = float("inf")
    text = Page(write_report(tmp_path / "nan.html", **results)).text
    assert "nan" not in text.lower().split()
    assert "inf" not in text.lower().split()


def test_regimes_stand_in_the_order_of_their_numbers(tmp_path):
    compare = compare_result(samples=600)
    wanted = ["below 2 Hz", "2-10 Hz", "10-50 Hz", "above 50 Hz"]
    for model in compare["models"]:
        parts = [
            {"kind": "frequency", "label": label, "tap": tap, "rmse_pa": 300.0, "share": 0.25}
            for label in (wanted[2], wanted[0], wanted[3], wanted[1])  # worst first, say
            for tap in TAPS
        ]
        model["regimes"] = parts + [r for r in model["regimes"] if r["kind"] != "frequency"]
    text = Page(write_report(tmp_path / "r.html", compare=compare)).text
    places = [text.index(label) for label in wanted]
    assert places == sorted(places)


@pytest.mark.long
@pytest.mark.parametrize("samples", [600, 60_000])
def test_sensors_read_in_turn_keep_their_readings(tmp_path, samples):
    compare = read_in_turn(compare_result(samples=samples))
    path = write_report(tmp_path / "r.html", compare=compare)
    assert path.stat().st_size < MAX_BYTES
    block = re.search(r'id="viewer-data">(.*?)</script>', path.read_text(encoding="utf-8"))
    data = json.loads(block[1])
    time = np.frombuffer(base64.b64decode(data["time"]), "<f8")
    assert data["taps"] == list(TAPS)
    for tap, gap, measured in zip(TAPS, data["gap"], data["measured"], strict=True):
        given = np.array(compare["series"]["measured"][tap], dtype=float)
        shown = np.frombuffer(base64.b64decode(measured), "<f4")
        there = time[np.isfinite(shown)]
        at = np.searchsorted(compare["series"]["time_s"], there)
        assert shown[np.isfinite(shown)] == pytest.approx(given[at], rel=1e-6)
        if samples == 600:  # there is room for all of them
            assert there.size == np.isfinite(given).sum()
        else:  # a line through what is left breaks only where there is a gap
            assert there.size < np.isfinite(given).sum()
            assert (np.diff(there) > gap).sum() <= (1 if tap == TAPS[-1] else 0)


def test_twelve_taps_and_four_models_stay_below_three_megabytes(tmp_path):
    compare = compare_result(tuple(f"tap_{i}" for i in range(12)))
    extra = copy.deepcopy(compare["models"][2]) | {"name": "delay line"}
    compare["models"].append(extra)
    compare["series"]["model"]["delay line"] = compare["series"]["model"]["thin plate"]
    path = write_report(tmp_path / "r.html", compare=compare)
    assert path.stat().st_size < MAX_BYTES


def test_bad_input_is_one_sentence_and_leaves_no_file(tmp_path):
    with pytest.raises(InputError, match="at least one result"):
        write_report(tmp_path / "r.html")
    with pytest.raises(InputError, match=r"fit result .* 'pneu\.compare/1'"):
        write_report(tmp_path / "r.html", fit=head("compare"))
    with pytest.raises(InputError, match="cannot be written"):
        write_report(tmp_path / "no_folder" / "r.html", learn=learn_result())
    assert not list(tmp_path.iterdir())


def test_the_fit_says_where_it_stops_short_and_what_was_held(tmp_path):
    fit = fit_result()
    page = write_report(tmp_path / "r.html", fit=fit).read_text()
    short = fit["shortfall"]
    # (the pages write minus signs and quotes as people do)
    for line in (short["sentence"], *short["where"]):
        assert line in page
    assert "sensor_lag@end would explain 61 %" in page
    row = page[page.index("chambers.bottle.volume_m3") :]
    row = row[: row.index("</tr>")]
    assert "held" in row and "not identified" not in row
    fit["shortfall"] = None
    assert "stops short" not in write_report(tmp_path / "r.html", fit=fit).read_text()


def test_a_failed_write_keeps_the_report_there_was(tmp_path):
    path = write_report(tmp_path / "r.html", fit=fit_result())
    before = path.read_bytes()
    with pytest.raises(InputError):
        write_report(path, fit=fit_result() | {"schema": "pneu.fit/2"})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (quantities.with_error(1.612e-8, 2.3e-10, "m^2"), "(1.612 ± 0.023)×10⁻⁸ m²"),
        (quantities.with_error(-8213.0, 950.0, "Pa"), "−8210 ± 950 Pa"),
        (quantities.with_error(0.00251, 0.00012, "s"), "2.51 ± 0.12 ms"),
        (quantities.with_error(1.1e-4, 2.4e-4, "s"), "0.11 ± 0.24 ms"),
        (quantities.with_error(0.0, 0.1), "0.00 ± 0.10"),
        (quantities.with_error(3.0, None, "1"), "3.000"),
        (quantities.number(0.09996), "0.100"),
        (quantities.number(635000.0), "6.35×10⁵"),
        (quantities.number(-3.4e-9), "−3.40×10⁻⁹"),
        (quantities.number(None), "–"),
        (quantities.percent(0.0994), "9.9 %"),
        (quantities.times(1.04), "1.04×"),
        (quantities.pretty_unit("m^3 s^-1 Pa^-1"), "m³ s⁻¹ Pa⁻¹"),
    ],
)
def test_quantities_carry_the_digits_their_error_leaves(text, wanted):
    assert text == wanted


# ---- In a real browser


@pytest.fixture(scope="module")
def browser() -> str:
    if BROWSER is None:
        pytest.skip(f"the report was not opened in a browser: {WITHOUT}")
    return BROWSER


def opened(browser: str, page: Path) -> tuple[str, dict[str, str]]:
    """The console, and the attributes of the page element after its scripts have run."""
    done = subprocess.run(
        [
            browser,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--no-first-run",
            "--enable-logging=stderr",
            "--v=0",
            f"--user-data-dir={page.parent / 'profile'}",
            "--virtual-time-budget=5000",
            "--window-size=1300,2000",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)
    root = re.search(r"<html\b([^>]*)>", done.stdout)
    assert root, done.stderr
    title = re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)
    attributes = dict(re.findall(r'([\w-]+)="([^"]*)"', root[1]))
    return console, attributes | {"title": title[1] if title else ""}


# What a reader does at the time plot. Each line of `seen` is a fact for the test to check.
EXERCISE = """
const seen = {};
const canvas = document.querySelector("#viewer canvas");
const output = document.querySelector("#viewer output");
window.requestAnimationFrame = (paint) => setTimeout(paint, 0); // a dumped page paints no frames
const frame = () => new Promise((done) => setTimeout(done, 50));
const range = () => output.value.match(/[\\d.]+/g).slice(0, 2).map(Number).join(" ");
const left = () => canvas.getBoundingClientRect().left;
const at = (x, more) => ({ clientX: left() + x, clientY: 60, bubbles: true, ...more });
const inked = () => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let count = 0;
  for (let i = 3; i < data.length; i += 4) count += data[i] > 0;
  return count / (canvas.width * canvas.height);
};
(async () => {
  seen.inked = inked();
  seen.start = range();
  const plot = canvas.clientWidth - 76;
  canvas.dispatchEvent(new PointerEvent("pointerdown", at(64 + plot / 3)));
  canvas.dispatchEvent(new PointerEvent("pointermove", at(64 + 2 * plot / 3)));
  canvas.dispatchEvent(new PointerEvent("pointerup", at(64 + 2 * plot / 3)));
  await frame(); seen.dragged = range();
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
  await frame(); seen.key = range();
  canvas.dispatchEvent(new PointerEvent("pointerdown", at(64, { shiftKey: true })));
  canvas.dispatchEvent(new PointerEvent("pointermove", at(64 + plot / 5, { shiftKey: true })));
  canvas.dispatchEvent(new PointerEvent("pointerup", at(64 + plot / 5, { shiftKey: true })));
  await frame(); seen.panned = range();
  const turn = { deltaY: -200, cancelable: true };
  canvas.dispatchEvent(new WheelEvent("wheel", at(64 + plot / 2, turn)));
  await frame(); seen.wheel = range();
  const cell = document.querySelector("rect[data-span]");
  cell.dispatchEvent(new MouseEvent("click", { bubbles: true }));
  await frame(); seen.map = range();
  canvas.dispatchEvent(new MouseEvent("dblclick", { bubbles: true }));
  await frame(); seen.reset = range();
  const height = canvas.clientHeight;
  for (const box of document.querySelectorAll("#viewer input")) box.click();
  await frame(); seen.shrunk = canvas.clientHeight < height / 3;
  for (const box of document.querySelectorAll("#viewer input")) box.click();
  await frame(); seen.restored = canvas.clientHeight === height;
  dispatchEvent(new Event("beforeprint"));
  dispatchEvent(new Event("afterprint"));
  await frame();
  for (const [key, value] of Object.entries(seen)) document.documentElement.dataset[key] = value;
})();
"""


@pytest.mark.long
def test_it_opens_in_a_browser_without_script_errors(tmp_path, browser):
    console, page = opened(browser, write_report(tmp_path / "all.html", **everything()))
    assert console == ""
    assert page.get("data-ready") == "yes"
    assert "data-script-error" not in page


@pytest.mark.long
def test_hostile_names_do_nothing_in_a_browser(tmp_path, browser):
    results = everything()
    for name in ("end", "pde + leak", "leak", "tube", "voltage", "a_hidden_3"):
        results = renamed(results, name, HOSTILE + name)
    console, page = opened(browser, write_report(tmp_path / "hostile.html", **results))
    assert console == ""
    assert page.get("data-ready") == "yes"
    assert page["title"] != "owned"


@pytest.mark.long
def test_the_time_plot_answers_mouse_wheel_keys_and_switches(tmp_path, browser):
    path = write_report(tmp_path / "plot.html", compare=compare_result())
    text = path.read_text(encoding="utf-8")
    # The policy would rightly refuse the script that plays the reader.
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", text)
    path.write_text(text.replace("</body>", f"<script>{EXERCISE}</script></body>"), "utf-8")
    console, page = opened(browser, path)
    assert console == ""
    assert "data-script-error" not in page

    def span(key: str) -> list[float]:
        return [float(number) for number in page[f"data-{key}"].split()]

    assert float(page["data-inked"]) > 0.05
    assert span("start") == [0.0, 15.0]
    assert span("dragged") == pytest.approx([5.0, 10.0], abs=0.02)
    assert span("key") == pytest.approx([6.0, 11.0], abs=0.02)  # a fifth of the span to the right
    assert span("panned") == pytest.approx([5.0, 10.0], abs=0.04)  # drawn a fifth to the right
    start, end = span("wheel")
    assert (start + end) / 2 == pytest.approx(7.5, abs=0.03)
    assert end - start == pytest.approx(5.0 * np.exp(-0.4), abs=0.02)
    assert span("map")[0] == 0.0
    assert span("map")[1] < 1.0
    assert span("reset") == [0.0, 15.0]
    assert page["data-shrunk"] == "true"
    assert page["data-restored"] == "true"
