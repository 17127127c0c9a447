# SPDX-License-Identifier: Apache-2.0
"""A small part of the fuzzer (`make fuzz`), and that it sees what it looks for."""

import os
import sys
import time

import pytest
import typer
from studies import fuzz

from pneu_sim.cli import build_app
from pneu_sim.errors import InputError

SEED = 20
CASES = {"rig": 60, "bag": 40, "csv": 25, "command": 25}


@pytest.fixture(scope="module")
def tallies():
    cases = [(kind, number) for kind, count in CASES.items() for number in range(count)]
    return fuzz.run_cases(cases, SEED, keep=None)


@pytest.mark.parametrize("kind", list(CASES))
def test_spoilt_input_ends_in_a_result_or_in_one_sentence(tallies, kind):
    tally = tallies[kind]
    assert not tally.failed, tally.failed
    assert tally.cases == CASES[kind]
    # neither so tame that all is accepted, nor so wild that nothing gets past the first check
    assert tally.accepted > 3 and tally.refused > 10


def broken(app):
    """Subcommands that do what no command may."""

    @app.command()
    def inside():
        raise ZeroDivisionError("by zero")

    @app.command()
    def talks():
        print("first", file=sys.stderr)
        raise InputError("second")

    @app.command()
    def leaves():
        with open("out.txt", "w") as stream:
            stream.write("half")
        raise InputError("no more room")

    @app.command()
    def forgets():
        with open(".out.txt.part", "w") as stream:
            stream.write("half")

    @app.command()
    def prints_escapes():
        os.write(2, b"pneu: \x1b[31mred\n")
        raise typer.Exit(2)

    @app.command()
    def stops():
        raise KeyboardInterrupt

    @app.command()
    def sound():
        raise InputError("a file: a field: found this, allowed is that")


@pytest.mark.parametrize(
    ("word", "fault"),
    [
        ("inside", "status 1"),
        ("talks", "not one line"),
        ("leaves", "yet written: out.txt"),
        ("forgets", "half-written"),
        ("prints-escapes", "cannot be printed"),
        ("stops", "status 130"),
        ("sound", ""),
    ],
)
def test_the_fuzzer_sees(tmp_path, monkeypatch, capfd, word, fault):
    app = build_app([])
    broken(app)
    monkeypatch.chdir(tmp_path)
    with capfd.disabled():
        ended = fuzz.run_one(app, [word], tmp_path)
    assert fault in ended.fault and bool(fault) == bool(ended.fault)


def test_a_worker_that_hangs_or_dies_is_replaced(tmp_path, monkeypatch):
    """The case that hangs is told as a failure, and the next one runs."""
    worker = fuzz.Worker()
    try:
        folders = [tmp_path / name for name in "abc"]
        for folder in folders:
            folder.mkdir()
        assert not any(end.fault for end in worker.run("rig", 1, 1, folders[0]))
        monkeypatch.setattr(worker, "_limit_s", 0.0)
        begun = time.monotonic()
        (end,) = worker.run("rig", 1, 1, folders[1])
        assert "not at an end" in end.fault and time.monotonic() - begun < 60.0
        monkeypatch.setattr(worker, "_limit_s", fuzz.LIMIT_S)
        assert not any(end.fault for end in worker.run("rig", 1, 1, folders[2]))
    finally:
        worker.stop()
