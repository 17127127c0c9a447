# SPDX-License-Identifier: Apache-2.0
"""Which topics and services tools do not list unless asked to."""

HIDDEN_TOPIC_PREFIX = "_"


def topic_or_service_is_hidden(name: str) -> bool:
    """Say whether a topic or service is hidden: a part of its name starts with an underscore.

    Args:
        name: The name.

    Returns:
        bool: Whether it is.
    """
    return any(token.startswith(HIDDEN_TOPIC_PREFIX) for token in name.split("/"))
