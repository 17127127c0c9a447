# SPDX-License-Identifier: Apache-2.0
"""Recordings of a scene, whatever kind of file."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pneu_common.errors import InputError
from pneu_sysid.contacts.read_bag import read_scene_bag
from pneu_sysid.contacts.read_csv import read_csv
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Track, unwound


def read_track(path: str | Path, loaded: Loaded) -> Track:
    """Reads a recording: a CSV file, a rosbag2 folder or an .mcap file.

    Args:
        path: Where it is.
        loaded: The scene.

    Raises:
        InputError: It is none, or lacks what the scene needs.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such recording")
    track = (
        read_csv(path, loaded) if path.suffix.lower() == ".csv" else read_scene_bag(path, loaded)
    )
    track = _unwound(track, loaded)
    begin, end = track.span_s
    if not end > begin:
        raise InputError(f"{path}: its sensors have no time in common")
    return track


def _unwound(track: Track, loaded: Loaded) -> Track:
    """The recording with hinges' angles that go on past a whole turn; it says so."""
    spec = loaded.setup().spec
    sensors, findings = dict(track.sensors), list(track.findings)
    for name, series in track.sensors.items():
        sensor = spec.sensor(name)
        if sensor.type.name != "mjSENS_JOINTPOS":
            continue
        if spec.joint(sensor.objname).type.name != "mjJNT_HINGE":
            continue
        wraps = int(np.sum(np.abs(np.diff(series.values[:, 0])) > np.pi))
        if wraps:
            sensors[name] = unwound(series)
            findings.append(f"sensor {name!r} begins its turn anew {wraps} times: put together")
    return replace(track, sensors=sensors, findings=tuple(findings))


def read_tracks(paths: Sequence[Path], loaded: Loaded) -> list[Track]:
    """Reads recordings; a folder of CSV files stands for all that are in it.

    Args:
        paths: Where they are.
        loaded: The scene.

    Raises:
        InputError: As `read_track`; or one was given twice.
    """
    files: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.csv")) if path.is_dir() else []
        files += inside or [path]
    seen: set[Path] = set()
    for file in files:
        if file.resolve() in seen:
            raise InputError(f"{file}: was given twice; each recording is needed once")
        seen.add(file.resolve())
    return [read_track(file, loaded) for file in files]
