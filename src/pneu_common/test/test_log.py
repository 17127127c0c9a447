# SPDX-License-Identifier: Apache-2.0
"""Messages of the packages' log reach one listener, as texts."""

import logging

import pytest

from pneu_common.log import LOG, hand_on

pytestmark = pytest.mark.kernel_free


def test_the_first_who_asks_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert LOG == "pneu"
    log = logging.getLogger("pneu")
    monkeypatch.setattr(log, "handlers", [])
    before = log.level
    first: list[str] = []
    second: list[str] = []
    try:
        hand_on(first.append)
        hand_on(second.append)
        logging.getLogger("pneu.kernel").info("compiling %s for %d s", "kernels", 60)
        log.debug("details")
    finally:
        log.setLevel(before)
    assert (first, second) == (["compiling kernels for 60 s"], [])
