# SPDX-License-Identifier: Apache-2.0
"""A local page on which a model is compared with recordings, and mended: `pneu workbench`."""
