# SPDX-License-Identifier: Apache-2.0
"""Where a recording comes from: machine, user, command line, revision of the source."""

import getpass
import platform
import shlex
import subprocess
import sys
import time

GIT_TIMEOUT_S = 5.0


def provenance(operator: str = "") -> dict[str, str]:
    """Returns what is kept in the bag beside the messages.

    Args:
        operator: Who recorded; empty: the user of the process.
    """
    return {
        "recorded_at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "host": platform.node(),
        "operator": operator or _user(),
        "command": shlex.join(sys.argv),
        "git_revision": _git("rev-parse", "HEAD"),
        "git_changes": _git("status", "--porcelain", "--untracked-files=no"),
    }


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry in the password file
        return ""


def _git(*arguments: str) -> str:
    """Output of git in the working directory; empty where there is no git or no repository."""
    try:
        done = subprocess.run(
            ["git", *arguments], capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
