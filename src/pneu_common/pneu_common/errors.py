# SPDX-License-Identifier: Apache-2.0
"""The exception for input a user can correct."""


class InputError(ValueError):
    """Signals unusable input: a file, a topic, a field or a value.

    The message is one sentence that names where the fault is, what was found
    and what is allowed; the command line prints it as it stands and exits 2.
    """
