# SPDX-License-Identifier: Apache-2.0
"""Lumped models of a rig: closed volumes filled through orifices, as baselines for the full model.

``build.build`` reduces a rig to its volumes as its ``model`` field says, ``batch.predict`` runs
many of them along recordings. Both mirror their namesakes in ``pneu_sim.rig.build`` and
``pneu_sim.simulate``.
"""
