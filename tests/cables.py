# SPDX-License-Identifier: Apache-2.0
"""Hosts of a test's own, two at the ends of each cable, and cables that can be pulled.

Each host is a network namespace. Making one needs the right to; a test that asks for a cable where
there is none is skipped and says so.
"""

import itertools
import os
import subprocess
import sys

import pytest

_NUMBERS = itertools.count()


def _ip(*words):
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=True)


class Cable:
    """Two hosts, `near` and `far`, and the cable between them."""

    def __init__(self):
        """Makes the hosts.

        Raises:
            OSError: There is no ``ip`` here.
            subprocess.CalledProcessError: Namespaces cannot be made here.
        """
        number = next(_NUMBERS)
        self.near, self.far = (f"pneu{os.getpid()}_{number}{end}" for end in "ab")
        self.address = f"10.77.{number}.2"
        self._processes = []
        _ip("netns", "add", self.near)
        try:
            _ip("netns", "add", self.far)
            cable = ("type", "veth", "peer", "name", "cable", "netns", self.far)
            _ip("link", "add", "cable", "netns", self.near, *cable)
            for host, end in ((self.near, 1), (self.far, 2)):
                _ip("-n", host, "addr", "add", f"10.77.{number}.{end}/24", "dev", "cable")
                _ip("-n", host, "link", "set", "lo", "up")
                _ip("-n", host, "link", "set", "cable", "up")
        except subprocess.CalledProcessError:
            self.close()
            raise

    def run(self, host, script, *arguments):
        """Runs Python code on a host until the cable is put away.

        Args:
            host: `near` or `far`.
            script: The code.
            *arguments: Its arguments.
        """
        command = ["ip", "netns", "exec", host, sys.executable, "-c", script, *map(str, arguments)]
        process = subprocess.Popen(command)
        self._processes.append(process)
        return process

    def pull(self):
        """Pulls the cable."""
        _ip("-n", self.far, "link", "set", "cable", "down")

    def plug(self):
        """Plugs it in again."""
        _ip("-n", self.far, "link", "set", "cable", "up")

    def close(self):
        """Ends what runs on the hosts, and removes them."""
        for process in self._processes:
            process.kill()
            process.wait()
        for host in (self.near, self.far):
            subprocess.run(["ip", "netns", "del", host], capture_output=True, check=False)


def new_cable():
    """Returns a cable between two new hosts; skips the test where there can be none."""
    try:
        return Cable()
    except OSError as error:
        pytest.skip(f"no network namespaces here: {error}")
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no network namespaces here: {error.stderr.strip()}")
