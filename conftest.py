# SPDX-License-Identifier: Apache-2.0
"""What holds for all tests: an interrupt reaches the processes they start.

A shell starts background jobs with SIGINT ignored, and children inherit that; tests that interrupt
a node would then wait for it for ever.
"""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
