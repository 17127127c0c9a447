# SPDX-License-Identifier: Apache-2.0
"""The gas kernel on a GPU: the same passes, one rig in each block of threads.

`translate` makes device functions of the passes, `batch` lays rigs out for blocks, `launch` runs
them.
"""
