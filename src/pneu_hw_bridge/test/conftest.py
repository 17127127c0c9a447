# SPDX-License-Identifier: Apache-2.0
"""What the tests of the bridge share: a lab in a process of its own, and patience."""

import pytest
from tests.bridges import RIG, running_lab, wait_until
from tests.modbus_devices import Server


@pytest.fixture(name="wait_until")
def patience():
    """Waits until something is true; returns how long that took."""
    return wait_until


@pytest.fixture
def start_lab():
    """Runs a lab of one's own."""
    return running_lab


@pytest.fixture
def rig_file():
    """The rig of the labs."""
    return RIG


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A lab that the tests of a module share."""
    with running_lab(tmp_path_factory.mktemp("lab"), "--seed", "7") as one:
        yield one


@pytest.fixture(scope="module")
def logging_lab(tmp_path_factory):
    """The same behind a device with a clock of its own."""
    options = ("--seed", "7", "--registers", "logging_plc")
    with running_lab(tmp_path_factory.mktemp("lab"), *options) as one:
        yield one


@pytest.fixture
def healthy_lab(lab):
    """The shared lab, without faults before and after."""
    lab.ask("clear")
    yield lab
    lab.ask("clear")


@pytest.fixture
def server():
    """A Modbus device that keeps what it is asked and told."""
    one = Server()
    one.open()
    yield one
    one.close()
    one.end()
