# SPDX-License-Identifier: Apache-2.0
"""The passes on a GPU do what they do on a processor: here under Numba's simulator of CUDA.

Where there is a GPU the same cases run on it (``make gpu``).
"""

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_sim import device
from pneu_sim.device import Device, chosen

pytestmark = pytest.mark.takes(20)

HOUSE = Path(__file__).parents[3]


def differences(steps: int, *cases: str) -> dict[str, tuple[float, str]]:
    """Largest difference of each case, under the simulator."""
    environment = os.environ | {"NUMBA_ENABLE_CUDASIM": "1", "PYTHONWARNINGS": "ignore"}
    words = [sys.executable, "-m", "src.pneu_sim.test.cuda_cases", "cuda", str(steps), *cases]
    done = subprocess.run(
        words, cwd=HOUSE, env=environment, capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return dict(json.loads(done.stdout.splitlines()[-1]))


STEPS = 5
"""One more than walls are refreshed after; the simulator takes its time for each."""
CASES = ("walls/2/hllc", "joint/2/exact")
MORE = (
    "regulator/1/hllc",
    "small/1/hllc",
    "legs/1/hllc",
    "walls/1/hllc",
    "finger/2/hllc",
    "cart/1/hllc",
    "cells/2/hllc",
)


SINGLE = "walls/2/hllc/cuda32"


def agree(found: dict[str, tuple[float, str]], cases: tuple[str, ...]) -> None:
    """Asserts that each case was run, and that the two devices agree to rounding."""
    assert set(found) == set(cases)
    for case, (worst, of) in found.items():
        assert worst < 1e-9, (case, of)


def test_a_gpu_does_what_the_processor_does() -> None:
    """In double precision to rounding, in single precision nearly; one process runs all cases."""
    found = differences(STEPS, *CASES, SINGLE)
    worst, of = found.pop(SINGLE)
    assert 1e-9 < worst < 1e-3, of
    agree(found, CASES)


@pytest.mark.long
def test_a_gpu_does_what_the_processor_does_in_more_cases() -> None:
    agree(differences(STEPS, *MORE), MORE)


@pytest.mark.long
def test_a_thousand_steps_with_every_pass() -> None:
    ((worst, of),) = differences(1000, "walls/2/hllc").values()
    assert worst < 1e-9, of


def test_without_a_gpu_the_processor_computes_and_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(device.VARIABLE, "cuda")
    monkeypatch.setattr("pneu_sim.cuda.launch.missing", lambda: "no CUDA device was found")
    device._found.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert chosen() == Device.CPU
        assert chosen() == Device.CPU
    assert [r.getMessage() for r in caplog.records] == [
        "PNEU_DEVICE is 'cuda', but no CUDA device was found: computing on the processor"
    ]
    device._found.cache_clear()


def test_a_device_that_there_is_not_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(device.VARIABLE, "gpu")
    with pytest.raises(InputError, match="PNEU_DEVICE: found 'gpu'; allowed are cpu, cuda, cuda32"):
        chosen()
