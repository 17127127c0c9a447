# SPDX-License-Identifier: Apache-2.0
"""The file of a predictive controller: the rig that it plans on, what it controls, settings."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_policy.control.predictive import PredictiveController
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_sim.rig.load import load_rig

FIELDS = ("pneu_controller", "kind", "rig", "tap", "taps", "settings")


def predictive_of(data: Mapping[str, Any], path: Path) -> PredictiveController:
    """Makes the controller that a file describes.

    Args:
        data: What the file holds.
        path: The file; the rig file's path is relative to its folder.

    Raises:
        InputError: A field is unknown, missing or wrong, or the rig cannot be planned on.
    """
    for name in data:
        if name not in FIELDS:
            raise InputError(f"{name}: unknown, known are {', '.join(FIELDS)}")
    rig = data.get("rig")
    if not isinstance(rig, str):
        raise InputError(f"rig: found {rig!r}, needed is the path of a rig file")
    tap, taps = data.get("tap", "end"), data.get("taps")
    if not isinstance(tap, str):
        raise InputError(f"tap: found {tap!r}, needed is the name of a tap")
    if taps is not None and not (isinstance(taps, list) and all(isinstance(t, str) for t in taps)):
        raise InputError(f"taps: found {taps!r}, needed are names of taps")
    given = data.get("settings") or {}
    if not isinstance(given, dict):
        raise InputError(f"settings: found {given!r}, needed is a mapping")
    try:
        settings = PredictiveSettings(**given)
    except InputError as error:
        raise InputError(f"settings.{error}") from None
    loaded = load_rig(path.parent / rig)
    return PredictiveController(loaded, tap, taps, settings, name=path.stem)


def save_predictive(
    path: Path, rig: str, tap: str, taps: list[str] | None, settings: Mapping[str, Any]
) -> None:
    """Writes the file of a predictive controller, whole or not at all.

    Args:
        path: Where; its folder must exist.
        rig: Path of the rig file from there.
        tap: Tap whose pressure it controls.
        taps: Taps it is told; None is all.
        settings: Settings that are not the usual ones.

    Raises:
        InputError: It cannot be written.
    """
    data: dict[str, Any] = {"pneu_controller": 1, "kind": "predictive", "rig": rig, "tap": tap}
    if taps is not None:
        data["taps"] = taps
    if settings:
        data["settings"] = dict(settings)
    yaml = YAML()
    yaml.default_flow_style = None
    text = io.StringIO()
    text.write("# SPDX-License-Identifier: Apache-2.0\n")
    yaml.dump(data, text)
    write_whole(path, text.getvalue())
