# SPDX-License-Identifier: Apache-2.0
"""How the process that plays a plan ends where not all was played: its exit status."""

from pneu_common.errors import InputError

BROKEN_OFF = 1
"""Something is wrong, or somebody stopped it: a person has to look before it is played again."""
UNTIMELY = 75
"""Time failed it: the clock, or readings that did not come in time. It may be played again (the
``EX_TEMPFAIL`` of sysexits.h)."""


class UntimelyError(InputError):
    """A plan was broken off for nothing but time, as on a busy machine."""
