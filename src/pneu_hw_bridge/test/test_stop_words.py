# SPDX-License-Identifier: Apache-2.0
"""`pneu stop` waits for no library that it does not need, whoever calls for it."""

import os
import subprocess
import sys

import pytest

from pneu_hw_bridge import stop_command
from pneu_hw_bridge.stop_command import at_once

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("words", [["--local"], ["--local", "--reason", "the workbench"]])
def test_it_begins_before_the_command_line_is_loaded(words, tmp_path):
    program = (
        "import sys\nfrom pneu_common.entry import main\n"
        "try:\n    main()\nfinally:\n    print('loaded:', {'typer', 'numpy'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "stop", *words],
        env=os.environ | {"PNEU_RUN_DIR": str(tmp_path)},  # nobody else's bridges
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "no bridge found on this machine" in done.stdout
    assert "loaded: set()" in done.stdout, done.stderr


def test_other_words_are_left_to_the_command_line(monkeypatch):
    monkeypatch.setattr(stop_command, "stop", lambda reason, local: pytest.fail("stopped"))
    others = (["--help"], ["--reason"], ["--reason", "a", "b"], ["now"], ["now", "please"])
    for words in (*others, ["a", "--reason"], ["--local", "a", "b"]):
        assert at_once(words) is None


def test_who_calls_for_it_is_passed_on(monkeypatch):
    monkeypatch.setattr(stop_command, "stop", lambda reason, local: (reason, local))
    assert at_once([]) == ("pneu stop", False)
    assert at_once(["--local"]) == ("pneu stop", True)
    assert at_once(["--reason", "smoke"]) == ("smoke", False)
    assert at_once(["--reason", "smoke", "--local"]) == ("smoke", True)
