# SPDX-License-Identifier: Apache-2.0
"""What controllers are trained and tuned on: targets, rigs, and the environment of the two."""
