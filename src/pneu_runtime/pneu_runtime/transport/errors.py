# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the transport."""

from pneu_common.errors import InputError


class TransportError(RuntimeError):
    """Signals that the middleware refused something."""


class ForeignServiceError(TransportError):
    """Signals a service whose server speaks another vendor's service protocol."""


class UnknownNodeError(LookupError):
    """Signals a node that is not in the graph."""


class EnvironmentVariableError(InputError):
    """Signals an environment variable that cannot be used."""
