# SPDX-License-Identifier: Apache-2.0
"""A cable that is pulled between bridge and device, and plugged in again: nothing old gets through.

The cables lie between network namespaces. Of those in which the bridge ends or falls silent while
its cable is out, without the bridge's care six in ten would open their valve for 0.1 s within 7 s.
"""

import pytest
from tests.cables import ENDS, pull_and_plug

pytestmark = pytest.mark.realtime

PULLED_S, AFTERWARDS_S = 3.0, 5.0


@pytest.mark.long
def test_what_waited_for_the_cable_is_never_sent(tmp_path):
    late = pull_and_plug(tmp_path, ENDS, PULLED_S, AFTERWARDS_S)
    assert not any(late.values()), late
