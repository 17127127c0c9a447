# SPDX-License-Identifier: Apache-2.0
"""Python's collector of garbage, kept from what stays: a full pass stops a process for a while.

Modules, rigs and compiled kernels are some hundred thousand objects, through which a pass goes for
60 to 100 ms: longer than a valve may wait for its command.
"""

import gc


def spare_what_stays() -> None:
    """Takes all that is there now to stay, after one last pass; to be called before time counts."""
    gc.collect()
    gc.freeze()
