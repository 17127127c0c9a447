# SPDX-License-Identifier: Apache-2.0
"""Stages of a study as words of its command line: none given are all of them."""

import argparse
from collections.abc import Sequence


def add_stages(parser: argparse.ArgumentParser, stages: Sequence[str]) -> None:
    """Adds the argument ``stages``, a list in the study's own order.

    Not by ``choices``: Python 3.11 holds a list of none against them.

    Args:
        parser: Of the study.
        stages: What there is.
    """
    parser.add_argument(
        "stages",
        nargs="*",
        action=_Stages,
        default=list(stages),
        const=tuple(stages),
        metavar="stage",
        help=f"any of {', '.join(stages)}; all unless given",
    )


class _Stages(argparse.Action):
    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        """Keeps the stages that were asked for."""
        given = list(values) if isinstance(values, list | tuple) else []
        unknown = [stage for stage in given if stage not in self.const]
        if unknown:
            parser.error(f"stage: found {unknown[0]!r}, allowed are {', '.join(self.const)}")
        asked = [stage for stage in self.const if stage in given]
        setattr(namespace, self.dest, asked or list(self.const))
