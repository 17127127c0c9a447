# SPDX-License-Identifier: Apache-2.0
"""Messages of chosen shapes, and the same messages for rosbags, whose codec is independent."""

import itertools
import random

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pneu_runtime import interfaces

SEQUENCE_LENGTHS = (0, 1, 3)
"""Empty, one element, and an odd number, which leaves 4- and 2-byte elements unaligned."""

STRING_LENGTHS = (0, 1, 2, 3, 4)
"""In bytes: every remainder that a string and its NUL leave modulo four."""

OWN_TYPES = sorted(name for name in interfaces.known_types() if name.startswith("pneu_msgs/msg/"))


def store_of_both():
    """The types of Jazzy as rosbags brings them, and our own as it reads their text."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own = {}
    for name in OWN_TYPES:
        own.update(get_types_from_msg(interfaces.full_text(name), name))
    store.register({name: fields for name, fields in own.items() if name not in store.fielddefs})
    return store


def variable_fields(name, path=()):
    """Paths of the strings and sequences of a message, those of messages within it included."""
    for field in interfaces.catalogue.registry().structure(name).fields:
        kind, here = field.type, (*path, field.name)
        if kind.kind in ("bounded", "sequence"):
            limit = kind.count or max(SEQUENCE_LENGTHS)
            yield here, sorted({min(length, limit) for length in SEQUENCE_LENGTHS})
        elif kind.kind == "one" and kind.is_message:
            yield from variable_fields(kind.base, here)
        elif kind.kind == "one" and kind.base == "string":
            limit = kind.string_bound or max(STRING_LENGTHS)
            yield here, [length for length in STRING_LENGTHS if length <= limit]


def shapes(name, most):
    """Lengths by path: all combinations, or so many at random where there are more.

    Args:
        name: Full name of the message.
        most: Most combinations.
    """
    fields = dict(variable_fields(name))
    count = 1
    for lengths in fields.values():
        count *= len(lengths)
    if count <= most:
        combinations = itertools.product(*fields.values())
    else:
        rng = random.Random(name)
        combinations = (tuple(map(rng.choice, fields.values())) for _ in range(most))
    for lengths in combinations:
        yield dict(zip(fields, lengths, strict=True))


class Filler:
    """Fills messages with values that all differ from zero, and from their neighbours.

    Args:
        lengths: Of strings and sequences, by path; those within elements are drawn.
        seed: Seed of the drawn lengths.
    """

    def __init__(self, lengths, seed):
        self.lengths = lengths
        self.rng = random.Random(seed)
        self.number = 0

    def message(self, cls, path=()):
        """Returns a message of a class.

        Args:
            cls: The class.
            path: Where it stands in the whole message; None within an element of a sequence.
        """
        made = cls()
        for field in interfaces.catalogue.registry().structure(interfaces.type_name(cls)).fields:
            here = None if path is None else (*path, field.name)
            setattr(made, field.name, self.value(field.type, here))
        return made

    def value(self, kind, path):
        """Returns a value of a type.

        Args:
            kind: The type.
            path: As for `message`.
        """
        if kind.kind != "one":
            length = kind.count
            if kind.kind != "array":
                length = self.length(path, SEQUENCE_LENGTHS, kind.count)
            one = type(kind)(kind.base, kind.string_bound)
            return [self.value(one, None) for _ in range(length)]
        if kind.is_message:
            return self.message(interfaces.message_class(kind.base), path)
        self.number += 1
        if kind.base == "string":
            length = self.length(path, STRING_LENGTHS, kind.string_bound)
            wide = "ä" * (length > 1 and self.number % 2)  # a character of two bytes
            letters = range(length - len(wide.encode()))
            return wide + "".join(chr(ord("a") + (self.number + i) % 26) for i in letters)
        if kind.base == "byte":
            return bytes([1 + self.number % 255])
        if kind.base == "bool":
            return self.number % 3 != 0
        if kind.base.startswith("float"):
            return -0.5 - self.number
        bits = int(kind.base.lstrip("uint"))
        highest = 2 ** (bits - (not kind.base.startswith("u"))) - 1
        return highest - self.number % 100  # so that every byte counts, also the highest

    def length(self, path, lengths, limit):
        """Returns the length of a string or sequence: given by its path, else drawn."""
        if path is not None:
            return self.lengths[path]
        return min(self.rng.choice(lengths), limit or max(lengths))


def of_rosbags(store, message):
    """The same message in the classes of rosbags, without a codec in between.

    Args:
        store: Its types.
        message: The message.
    """
    name = interfaces.type_name(type(message))
    values = {}
    for field in interfaces.catalogue.registry().structure(name).fields:
        kind, value = field.type, getattr(message, field.name)
        if kind.is_message:
            several = kind.kind != "one"
            value = (
                [of_rosbags(store, one) for one in value] if several else of_rosbags(store, value)
            )
        elif kind.base == "string":
            value = list(value) if kind.kind != "one" else value
        elif kind.base == "byte":
            value = np.frombuffer(b"".join(value), np.uint8) if kind.kind != "one" else value[0]
        elif kind.kind != "one":
            value = np.asarray(value, np.dtype(kind.base))
        values[field.name] = value
    if not values:  # rosbags has the byte that stands for an empty structure as a field
        values["structure_needs_at_least_one_member"] = 0
    return store.types[name](**values)
