# SPDX-License-Identifier: Apache-2.0
"""Where a recording comes from: machine, user, command line, revision of the source."""

import contextlib
import getpass
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

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
        "git_changes": _changes(),
    }


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry in the password file
        return ""


def _changes() -> str:
    """Return the changed files of the repository, as `git status` has them.

    A repository's own configuration names programs that `git status` runs: monitors, filters,
    hooks. A repository that was received is therefore looked at with a configuration of our own.
    """
    where = _git("rev-parse", "--show-toplevel", "--git-path", "index", "--git-path", "objects")
    revision = _git("rev-parse", "HEAD")
    if len(parts := where.splitlines()) != 3 or not revision:
        return ""
    top, index, objects = parts[0], os.path.abspath(parts[1]), os.path.abspath(parts[2])
    with contextlib.suppress(OSError), tempfile.TemporaryDirectory(prefix="pneu-git-") as folder:
        for name in ("objects", "refs"):
            (Path(folder) / name).mkdir()
        (Path(folder) / "HEAD").write_text(f"{revision}\n")
        (Path(folder) / "config").write_text("[core]\n\trepositoryformatversion = 0\n")
        shutil.copy(index, Path(folder) / "index")
        words = ("--work-tree", top, "status", "--porcelain", "--untracked-files=no")
        return _git(*words, "--ignore-submodules=all", GIT_DIR=folder, GIT_OBJECT_DIRECTORY=objects)
    return ""  # no index, or no room


def _git(*arguments: str, **environment: str) -> str:
    """Output of git in the working directory; empty where there is no git or no repository."""
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", *arguments],
            capture_output=True,
            text=True,
            timeout=GIT_TIMEOUT_S,
            check=True,
            env={**os.environ, **environment},
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
