# SPDX-License-Identifier: Apache-2.0
"""Equations of motion of the bodies that pistons move, one lane at a time.

A kind of body is two files: what a rig file says of it, in ``pneu_sim.bodies``, which is read
without a compiler, and its equations here, two compiled functions:

    mechanics(par, b, j, q, v, mass, force)   mass matrix, and the forces but those of cylinders
    levers(par, b, j, q, extension, lever)    extensions of its cylinders, and their derivatives

``par`` is ``(n_bodies, BODY_PARAMS, lanes)``, of which ``par[b, :, j]`` holds the numbers of
`Body.numbers` in their order. ``q`` and ``v`` are positions and velocities of the joints; ``mass``
is to be filled with the whole matrix M, ``force`` with what stands on the right of M dv/dt = ...:
gravity, and what comes of velocities. Friction, damping and stops of joints and cylinders are added
by the kernel, alike for all kinds. ``lever[c, i]`` is the growth of the extension of cylinder c per
motion of joint i.
"""
