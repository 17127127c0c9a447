# SPDX-License-Identifier: Apache-2.0
"""A small part of the fuzzer (`make fuzz`), and that it sees what it looks for."""

import os
import sys

import pytest
import typer
from studies import fuzz

from pneu_common.cli import build_app
from pneu_common.errors import InputError

SEED = 0
CASES = {"rig": 24, "bag": 20, "csv": 12, "command": 16}


@pytest.fixture(scope="module")
def worker():
    one = fuzz.Worker()
    yield one
    one.stop()


@pytest.fixture(scope="module")
def tallies(worker):
    cases = [(kind, number) for kind, count in CASES.items() for number in range(count)]
    return fuzz.run_cases(worker, cases, SEED, keep=None)


@pytest.mark.long
@pytest.mark.parametrize("kind", list(CASES))
def test_spoilt_input_ends_in_a_result_or_in_one_sentence(tallies, kind):
    tally = tallies[kind]
    assert not tally.failed, tally.failed
    assert tally.cases == CASES[kind]
    # neither so tame that all is accepted, nor so wild that nothing gets past the first check
    assert tally.accepted > 0 and tally.refused > 5


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


@pytest.mark.long
def test_a_worker_that_hangs_is_replaced(worker, tmp_path, monkeypatch):
    """The case that hangs is told as a failure, and the next one runs."""
    for name in "ab":
        (tmp_path / name).mkdir()
    monkeypatch.setattr(worker, "_limit_s", 0.0)
    (end,) = worker.run("rig", 1, 1, tmp_path / "a")
    assert "not at an end" in end.fault
    monkeypatch.setattr(worker, "_limit_s", fuzz.LIMIT_S)
    assert not any(end.fault for end in worker.run("rig", 1, 1, tmp_path / "b"))


def test_progress_is_no_complaint():
    said = "scores: 0:12 so far, 62 % done, about 0:05 left of this\ndone after 0:16\n"
    assert fuzz._fault(2, said + "pneu: a: b\n", {}, {}) == ""
    assert "not one line" in fuzz._fault(2, said + "pneu: a\npneu: b\n", {}, {})
