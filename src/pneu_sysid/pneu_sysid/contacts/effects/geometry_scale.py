# SPDX-License-Identifier: Apache-2.0
"""Bodies that are larger or smaller than their drawing."""

import numpy as np

from pneu_sysid.contacts.effects.base import ALL, SceneEffect, Setup, touching


class GeometryScale(SceneEffect):
    """Relative error of the size of what touches, at the same mass; meshes keep their size."""

    name = "geometry_scale"
    title = "size of bodies"
    unit = ""
    lower = -0.3
    upper = 0.3
    typical = 0.01
    absent = 0.0
    formula = "sizes and places of geoms in their body, times 1 + error"
    source = "Dojo, system identification of a cube"

    def places(self, setup: Setup) -> list[str]:
        return [ALL] if any(g.parent.name != "world" for g in touching(setup)) else []

    def value(self, setup: Setup, place: str) -> float:
        return setup.scaled - 1.0

    def put(self, setup: Setup, place: str, value: float) -> None:
        by = (1.0 + value) / setup.scaled
        for geom in touching(setup):
            if geom.parent.name != "world":
                geom.size = [x * by for x in geom.size]
                geom.pos = [x * by for x in geom.pos]
                if np.isfinite(geom.fromto).all():  # these then replace size and place
                    geom.fromto = [x * by for x in geom.fromto]
                if not geom.meshname:  # of no effect where the MJCF gives the mass
                    geom.density /= by**3
        # Of bodies whose inertia an effect has written out the geoms no longer imply it.
        for name in {*setup.massive, *(body for body, _ in setup.shifted)}:
            body = setup.spec.body(name)
            shift = [setup.shifted.get((name, axis), 0.0) for axis in range(3)]
            body.ipos = [(x - s) * by + s for x, s in zip(body.ipos, shift, strict=True)]
            body.inertia = [x * by**2 for x in body.inertia]
            body.fullinertia = [x * by**2 for x in body.fullinertia]
        setup.scaled = 1.0 + value
