# SPDX-License-Identifier: Apache-2.0
"""Versions of a model as a tree: what was added to what, and what it left of the error."""

from collections.abc import Iterator
from dataclasses import dataclass, field


@dataclass
class Version:
    """A model.

    Attributes:
        number: Its own; the first is 0.
        parent: Number of the one that it came from; None is the first.
        title: What was done, in words.
        folder: Where its rig file and what was looked at lie, in the session's folder.
        rig: Its rig file.
        added: How many effects were added since the first.
        times_noise: Error of each sensor over its noise.
        overall: The same, root mean square.
    """

    number: int
    parent: int | None
    title: str
    folder: str
    rig: str
    added: int = 0
    times_noise: dict[str, float | None] = field(default_factory=dict)
    overall: float | None = None


@dataclass
class Versions:
    """All of them.

    Attributes:
        all: In the order in which they were made.
        at: Number of the one that is looked at; None as long as there is none.
        undone: Numbers that were gone back from, the latest last.
    """

    all: list[Version] = field(default_factory=list)
    at: int | None = None
    undone: list[int] = field(default_factory=list)

    @property
    def now(self) -> Version | None:
        """The one that is looked at."""
        return None if self.at is None else self.all[self.at]

    @property
    def before(self) -> Version | None:
        """The one that it came from."""
        now = self.now
        return None if now is None or now.parent is None else self.all[now.parent]

    def add(self, version: Version) -> None:
        """Adds one that came from the present one, and looks at it.

        Args:
            version: It; its number and parent are set.
        """
        version.number, version.parent = len(self.all), self.at
        self.all.append(version)
        self.at = version.number
        self.undone.clear()

    def replace(self, version: Version) -> None:
        """Puts another in the place of the present one.

        Args:
            version: It; its number and parent are those of the present one.
        """
        now = self.now
        if now is None:
            self.add(version)
            return
        version.number, version.parent = now.number, now.parent
        self.all[now.number] = version

    def undo(self) -> bool:
        """Goes back to where the present one came from; returns whether there was such."""
        now = self.now
        if now is None or now.parent is None:
            return False
        self.undone.append(now.number)
        self.at = now.parent
        return True

    def redo(self) -> bool:
        """Takes the last step back again; returns whether there was one."""
        if not self.undone:
            return False
        self.at = self.undone.pop()
        return True

    def go(self, number: int) -> None:
        """Looks at another.

        Args:
            number: Which.
        """
        if not 0 <= number < len(self.all):
            raise IndexError(number)
        self.at = number
        self.undone.clear()

    def tree(self) -> Iterator[tuple[int, Version]]:
        """Depth and version, children under what they came from."""

        def under(parent: int | None, depth: int) -> Iterator[tuple[int, Version]]:
            for version in self.all:
                if version.parent == parent:
                    yield depth, version
                    yield from under(version.number, depth + 1)

        return under(None, 0)
