# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the message layer."""

from pneu_common.errors import InputError


class UnknownInterfaceError(InputError, LookupError):
    """Signals an interface type of which no definition is found."""


class DefinitionError(InputError):
    """Signals a definition that cannot be understood."""


class DecodeError(ValueError):
    """Signals bytes that are no valid CDR of the expected type."""


class EncodeError(ValueError):
    """Signals a message that holds something its type cannot express on the wire."""
