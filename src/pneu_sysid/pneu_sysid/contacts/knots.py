# SPDX-License-Identifier: Apache-2.0
"""Knots laid along a recording, finer where bodies are near each other; where these are seen."""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.chain import POSITION, VELOCITY, Chain, Channel, Floats, Ints
from pneu_sysid.contacts.manifold import conjugate, manifold_of, product
from pneu_sysid.contacts.names import AXES
from pneu_sysid.contacts.norms import Norm
from pneu_sysid.contacts.rest import touching_down
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Track


def chain_of(loaded: Loaded, track: Track, model: Any, step_s: float | None = None) -> Chain:
    """Lays knots along a recording.

    Args:
        loaded: The scene.
        track: The recording.
        model: The model that says where bodies are near each other.
        step_s: Instead of the scene's steps, this one throughout.

    Raises:
        InputError: The recording is too short.
    """
    scene = loaded.scene
    begin, end = track.span_s
    names = [name for name in loaded.names if name in track.sensors]
    poses = [
        track.sensors[name]
        for name in names
        if int(model.sensor_needstage[model.sensor(name).id]) == POSITION
    ]
    knots = scene.knots
    coarse = step_s or knots.step_s
    slow = max(poses, key=lambda s: s.every_s, default=None)
    if slow is not None and slow.every_s >= 0.6 * coarse:
        marks = slow.time_s[(slow.time_s >= begin - 1e-9) & (slow.time_s <= end + 1e-9)]
    else:
        marks = np.linspace(begin, end, max(2, round((end - begin) / coarse) + 1))
    if len(marks) < 4:
        raise InputError(f"{track.name}: {end - begin:.3g} s with {len(marks)} readings: too short")
    fine = knots.contact_step_s if step_s is None else None
    near = _near(model, guess(loaded, track, marks, model), knots.near_m)
    time: list[float] = []
    for k, (a, b) in enumerate(pairwise(marks)):
        step = fine if fine is not None and near[k] else coarse
        parts = max(1, int(np.ceil((b - a) / step - 1e-6)))
        time += list(a + (b - a) * np.arange(parts) / parts)
    t = np.array([*time, marks[-1]])
    return Chain(
        track.name,
        t,
        tuple(channel_of(loaded, track, model, t, name) for name in names),
        control_of(track, model, t),
        manifold_of(model),
        _dof_norms(loaded, model),
        _free(model),
        guess(loaded, track, t, model),
        np.ones((len(t), int(model.nv))),
        near[np.clip(np.searchsorted(marks, t, side="right") - 1, 0, len(near) - 1)],
    )


def channel_of(loaded: Loaded, track: Track, model: Any, t: Floats, name: str) -> Channel:
    """A sensor along knots.

    Args:
        loaded: The scene.
        track: The recording.
        model: The model.
        t: (n,) the knots.
        name: The sensor.
    """
    sensor = int(model.sensor(name).id)
    series = track.sensors[name]
    stage = int(model.sensor_needstage[sensor])
    width = int(model.sensor_dim[sensor])
    # the first knot has no velocity, the last no acceleration
    first, last = (0, len(t) - 1) if stage == POSITION else (1, len(t) - 1)
    if stage > VELOCITY:
        last = len(t) - 2
    every = float(np.median(np.diff(t)))
    fast = series.every_s < 0.75 * every
    if fast:
        knots = np.arange(first, last + 1)
        inside = (t[knots] >= series.time_s[0]) & (t[knots] <= series.time_s[-1])
        knots = knots[inside]
    else:
        nearest = np.clip(np.searchsorted(t, series.time_s), 1, len(t) - 1)
        nearer = series.time_s - t[nearest - 1] < t[nearest] - series.time_s
        nearest = nearest - nearer
        inside = np.abs(t[nearest] - series.time_s) <= 0.51 * np.max(np.diff(t))
        knots = np.unique(nearest[inside])
        knots = knots[(knots >= first) & (knots <= last)]
    return Channel(
        name,
        int(model.sensor_adr[sensor]),
        width,
        int(model.sensor_datatype[sensor]) == 3,  # mjDATATYPE_QUATERNION
        stage,
        loaded.scene.sensors[name].norm.norm(),
        series,
        fast,
        knots,
        tuple(AXES.index(axis) for axis in loaded.scene.sensors[name].unzeroed),
    )


def control_of(track: Track, model: Any, t: Floats) -> Floats:
    """(n, nu) what actuators are told at knots.

    Args:
        track: The recording.
        model: The model.
        t: (n,) the knots.
    """
    out = np.zeros((len(t), int(model.nu)))
    for name, series in track.controls.items():
        out[:, model.actuator(name).id] = series.at(t)[:, 0]
    return out


def _dof_norms(loaded: Loaded, model: Any) -> tuple[Norm, ...]:
    out: list[Norm] = []
    for j in range(model.njnt):
        name = model.joint(j).name
        force = loaded.forces_of(model, j)
        kind = int(model.jnt_type[j])
        wanted = {0: ("translation", "rotation"), 1: ("rotation",)}.get(kind, ("along",))
        for part in wanted:
            settings = getattr(force, part)
            if settings is None:
                raise InputError(f"forces: {name}: {part} is needed for a joint of its type")
            out += [settings.norm()] * (1 if part == "along" else 3)
    return tuple(out)


def _free(model: Any) -> Ints:
    at = [int(model.jnt_dofadr[j]) for j in range(model.njnt) if int(model.jnt_type[j]) == 0]
    return np.array([range(k, k + 3) for k in at], dtype=np.int64).reshape(-1, 3)


def guess(loaded: Loaded, track: Track, t: Floats, model: Any) -> Floats:
    """(n, nq) configurations as sensors of position alone tell them; the MJCF's where none does.

    Joints are where their encoders say, also those that an encoder tells with others, by a fixed
    tendon; bodies that move freely where a frame on them is seen, and
    where its zero is the recording's own, so that they touch what is fixed.

    Args:
        loaded: The scene.
        track: The recording.
        t: (n,) times.
        model: The model.
    """
    mujoco = mujoco_module()
    q = np.tile(np.array(model.qpos0), (len(t), 1))
    where: dict[int, Floats] = {}
    turned: dict[int, Floats] = {}
    unzeroed: list[tuple[int, int, int]] = []
    told: set[int] = set()
    together: list[tuple[int, Floats]] = []
    kinds = mujoco.mjtSensor
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in loaded.names:
        if name not in track.sensors:
            continue
        sensor = int(model.sensor(name).id)
        kind, thing = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        if kind == kinds.mjSENS_JOINTPOS:
            q[:, model.jnt_qposadr[thing]] = track.sensors[name].smooth(t)[:, 0]
            told.add(thing)
        elif kind == kinds.mjSENS_TENDONPOS:
            together.append((thing, track.sensors[name].smooth(t)[:, 0]))
        elif kind in (kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT):
            if int(model.sensor_refid[sensor]) >= 0:
                continue
            body, place, turn = _frame(
                mujoco, model, data, int(model.sensor_objtype[sensor]), thing
            )
            joint = int(model.body_jntadr[body])
            if joint < 0 or int(model.jnt_type[joint]) != 0:
                continue
            address = int(model.jnt_qposadr[joint])
            if kind == kinds.mjSENS_FRAMEQUAT:
                seen = track.sensors[name].smooth(t, True)
                q[:, address + 3 : address + 7] = product(seen, conjugate(turn)[None])
                turned[address] = seen
            else:
                q[:, address : address + 3] = track.sensors[name].smooth(t)
                where[address] = place
                unzeroed += [
                    (joint, address, AXES.index(axis))
                    for axis in loaded.scene.sensors[name].unzeroed
                ]
    _untangle(q, told, together, model)
    for address, place in where.items():
        if np.any(place):
            at = q[:, address + 3 : address + 7]
            zero = np.zeros((len(t), 1))
            carried = product(product(at, np.concatenate([zero, zero + place], 1)), conjugate(at))
            q[:, address : address + 3] -= carried[:, 1:]
    for joint, address, component in unzeroed:
        q[:, address + component] += touching_down(q, joint, component, model)
    return q


def _untangle(q: Floats, told: set[int], together: list[tuple[int, Floats]], model: Any) -> None:
    """Puts joints where encoders of fixed tendons say, those with encoders of their own held.

    Args:
        q: (n, nq) configurations, changed in place.
        told: Joints with encoders of their own.
        together: Tendons, and (n,) how long each was read.
        model: The model.
    """
    rows, lengths = [], []
    of_joint = int(mujoco_module().mjtWrap.mjWRAP_JOINT)
    for tendon, length in together:
        first = int(model.tendon_adr[tendon])
        at = range(first, first + int(model.tendon_num[tendon]))
        if any(int(model.wrap_type[k]) != of_joint for k in at):
            continue  # its way through space tells no joint
        row = np.zeros(int(model.njnt))
        for k in at:
            row[int(model.wrap_objid[k])] += float(model.wrap_prm[k])
        rows.append(row)
        lengths.append(length)
    if not rows:
        return
    by = np.array(rows)
    free = [j for j in np.flatnonzero(by.any(axis=0)) if int(j) not in told]
    if not free:
        return
    addresses = model.jnt_qposadr
    known = [j for j in range(int(model.njnt)) if by[:, j].any() and j not in free]
    left = np.array(lengths) - by[:, known] @ q[:, addresses[known]].T
    q[:, addresses[free]] = (np.linalg.pinv(by[:, free]) @ left).T


def _frame(mujoco: Any, model: Any, data: Any, kind: int, thing: int) -> tuple[int, Floats, Floats]:
    """Body of a frame, and where the frame is in it, m and as a quaternion."""
    kinds = mujoco.mjtObj
    at_rest = np.array([1.0, 0.0, 0.0, 0.0])
    if kind == kinds.mjOBJ_BODY:
        return thing, np.array(model.body_ipos[thing]), np.array(model.body_iquat[thing])
    if kind == kinds.mjOBJ_SITE:
        body = int(model.site_bodyid[thing])
        return body, np.array(model.site_pos[thing]), np.array(model.site_quat[thing])
    if kind == kinds.mjOBJ_GEOM:
        body = int(model.geom_bodyid[thing])
        return body, np.array(model.geom_pos[thing]), np.array(model.geom_quat[thing])
    return thing, np.zeros(3), at_rest


def _near(model: Any, q: Floats, near_m: float) -> NDArray[np.bool_]:
    """(n - 1,) whether anything is near anything between two instants."""
    mujoco = mujoco_module()
    widened = mujoco.MjModel.__copy__(model)
    widened.geom_margin[:] += near_m
    data = mujoco.MjData(widened)
    touches = np.zeros(len(q), dtype=bool)
    for i, at in enumerate(q):
        data.qpos[:] = at
        mujoco.mj_fwdPosition(widened, data)
        touches[i] = data.ncon > 0
    return touches[:-1] | touches[1:]
