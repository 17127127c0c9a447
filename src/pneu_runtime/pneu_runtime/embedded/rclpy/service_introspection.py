# SPDX-License-Identifier: Apache-2.0
"""What services may publish about their requests and responses."""

from enum import IntEnum


class ServiceIntrospectionState(IntEnum):
    """What is published about requests and responses."""

    OFF = 0
    METADATA = 1
    CONTENTS = 2
