# SPDX-License-Identifier: Apache-2.0
"""Bodies that cylinders move: small ones, solved inside the gas kernel.

A body is one file for what a rig file says of it, with itself as MJCF, and one of the same name for
its equations in ``pneu_sim.kernel.equations``; it stands in ``kinds`` here and there with one line
in each table. ``base`` says what a body has to have.
"""
