# SPDX-License-Identifier: Apache-2.0
"""Skip the tests of the embedded runtime where `import rclpy` gives the genuine one."""

from pathlib import Path

import pytest

from pneu_runtime import hook


def pytest_collection_modifyitems(items):
    if not hook.install():
        genuine = pytest.mark.skip(reason="about the embedded rclpy; the genuine one is in use")
        for item in items:
            if item.path.is_relative_to(Path(__file__).parent):
                item.add_marker(genuine)
