# SPDX-License-Identifier: Apache-2.0
"""Bodies that cylinders move: small ones, solved inside the gas kernel.

A body is one file: what a rig file says of it, its equations of motion, and the same body as MJCF.
It stands in ``kinds`` with one line in each of its tables. ``base`` says what a body has to have.
"""
