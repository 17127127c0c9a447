# SPDX-License-Identifier: Apache-2.0
"""One task as a process of its own, so that it can be ended at any time.

The process reads one request from its standard input (JSON, the fields of `Request`) and writes
one JSON object per line to its standard output: ``{"stage": …, "progress": …}`` while it works,
``{"errors": {sensor: …}}`` as they fall, ``{"early": folder}`` once what was measured lies there,
then ``{"success": …, "message": …, "verdict": …, "result_file": …}``. When its standard input
closes, the process that asked is gone: it clears up and ends.
"""

import json
import os
import shutil
import sys
import threading
from dataclasses import asdict

from pneu_common.errors import InputError
from pneu_common.log import hand_on
from pneu_sysid.tasks.child import answering
from pneu_sysid.tasks.perform import perform
from pneu_sysid.tasks.request import Outcome, Request


def main() -> None:
    """Serves the one request that this process was started for."""
    request, say = Request(**json.loads(sys.stdin.readline())), answering()
    threading.Thread(target=_end_with_asker, args=(request,), daemon=True).start()

    def tell(stage: str, done: float) -> None:
        say({"stage": stage, "progress": done})

    hand_on(lambda text: tell(text, 0.0))
    try:
        outcome = perform(
            request,
            tell,
            lambda errors: say({"errors": errors}),
            lambda folder: say({"early": str(folder)}),
        )
    except InputError as error:
        outcome = Outcome(False, str(error))
    except OSError as error:
        outcome = Outcome(False, f"{error.filename}: {error.strerror}")
    say(asdict(outcome))


def _end_with_asker(request: Request) -> None:
    sys.stdin.read()
    shutil.rmtree(request.aside, ignore_errors=True)
    os._exit(1)


if __name__ == "__main__":
    main()
