# SPDX-License-Identifier: Apache-2.0
"""The JSON results: what may be in them, how they are written, and their page."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sysid.results.compare import regime_order
from pneu_sysid.results.files import RESULTS, result_of, write_json
from pneu_sysid.results.learn import LearnResult
from pneu_sysid.results.page import json_markdown

HOUSE = Path(__file__).parents[3]


def learned(**changes: Any) -> dict[str, Any]:
    head = {
        "schema": "pneu.learn/1",
        "pneu_version": "0",
        "recording": "bag",
        "rigs": ["tube"],
        "taps": ["end"],
        "noise_floor_pa": {"end": 250.0},
    }
    step = {
        "step": 0,
        "added": None,
        "rmse_pa": {"end": np.float64(900.5)},
        "held_out_rmse_pa": {"end": float("nan")},
        "total_times_noise": 3.6,
        "held_out_times_noise": float("inf"),
    }
    body = {"steps": [step], "verdict": "unknown", "sentence": "Something.", "output": None}
    return {**head, **body, **changes}


def test_page_is_current() -> None:
    page = (HOUSE / "docs" / "json.md").read_text(encoding="utf-8")
    assert page == json_markdown(), "run python -m pneu_sysid.results.page > docs/json.md"


def test_every_key_has_a_meaning() -> None:
    for line in json_markdown().splitlines():
        if line.startswith("| `"):
            assert line.split("|")[3].strip(), line


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    write_json(tmp_path / "r.json", learned())

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    data = json.loads((tmp_path / "r.json").read_text(), parse_constant=refuse)
    assert data["steps"][0]["held_out_rmse_pa"] == {"end": None}
    assert data["steps"][0]["held_out_times_noise"] is None
    assert data["steps"][0]["rmse_pa"] == {"end": 900.5}
    assert next(iter(data)) == "schema"
    assert isinstance(result_of(data), LearnResult)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"schema": "pneu.learn/9"}, "known are pneu.compare/1, pneu.fit/1"),
        ({"verdict": "perhaps"}, "verdict"),
        ({"extra": 1}, "extra"),
        ({"steps": [{"step": 0}]}, r"steps\.0\.added"),
    ],
)
def test_other_data_are_refused(tmp_path: Path, changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        write_json(tmp_path / "r.json", learned(**changes))
    assert not list(tmp_path.iterdir())


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent/r\.json: cannot be written"):
        write_json(tmp_path / "absent" / "r.json", learned())


def test_schemas_are_named_after_their_command() -> None:
    names = [kind.model_fields["schema_"].default for kind in RESULTS]
    commands = ("compare", "fit", "diagnose", "learn", "friction", "observe")
    assert names[:6] == [f"pneu.{command}/1" for command in commands]
    assert names[6:10] == [f"pneu.scene_{command}/1" for command in commands[:4]]
    assert names[10:] == ["pneu.plan/1"]  # of `pneu excite`


def test_regimes_are_sorted_as_numbers() -> None:
    def regime(kind: str, label: str, **more: Any) -> dict[str, Any]:
        return {"kind": kind, "label": label, **more}

    wanted = [
        regime("choked", "v2.supply choked", of="v2.supply"),
        regime("choked", "v10.supply choked", of="v10.supply"),
        regime("opening", "v2 closed", of="v2", lower=0.0, upper=0.005),
        regime("opening", "v2 below 10 % open", of="v2", lower=0.005, upper=0.1),
        regime("opening", "v2 10-50 % open", of="v2", lower=0.1, upper=0.5),
        regime("opening", "v2 above 50 % open", of="v2", lower=0.5, upper=None),
        regime("opening", "v10 closed", of="v10", lower=0.0, upper=0.005),
        regime("pressure", "1.95-6.10 bar", lower=1.95e5, upper=6.1e5),
        regime("pressure", "6.10-10.25 bar", lower=6.1e5, upper=1.025e6),
        regime("pressure", "10.25-14.40 bar", lower=1.025e6, upper=1.44e6),
        # Without bounds, as in results of older versions.
        regime("frequency", "below 2 Hz"),
        regime("frequency", "2 to 10 Hz"),
        regime("frequency", "10-50 Hz"),
        regime("frequency", "above 50 Hz"),
        regime("time", "2-3 s", lower=2.0, upper=3.0),
        regime("time", "10-11 s", lower=10.0, upper=11.0),
    ]
    mixed = random.Random(3).sample(wanted, len(wanted))
    assert mixed != wanted
    assert sorted(mixed, key=regime_order) == wanted
