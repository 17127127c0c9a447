# SPDX-License-Identifier: Apache-2.0
"""Options that several commands share."""

import re

import pytest
import typer
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_common.options import Force

pytestmark = pytest.mark.kernel_free


def test_the_largest_seed_is_that_of_a_signed_integer_of_32_bits() -> None:
    words = ["lab", "--rig", "/no/rig.yaml", "--seed"]
    for seed, said in (
        ("2147483648", r"pneu: .*'--seed': .*\b2147483647\b.*\n"),
        ("-1", r"pneu: .*'--seed': .*\b0\b.*\n"),
        ("2147483647", r"pneu: /no/rig\.yaml: no such rig file\n"),
        ("0", r"pneu: /no/rig\.yaml: no such rig file\n"),
    ):
        done = CliRunner().invoke(build_app(wanted="lab"), [*words, seed], prog_name="pneu")
        assert done.exit_code == 2 and re.fullmatch(said, done.stderr), done.stderr


def test_force_is_a_flag_that_is_off_unless_given() -> None:
    app = typer.Typer()

    @app.command()
    def write(force: Force = False) -> None:
        print(force)

    run = CliRunner().invoke
    assert [run(app, words).stdout for words in ([], ["--force"])] == ["False\n", "True\n"]
    assert run(app, ["--no-force"]).exit_code == 2
    text = " ".join(run(app, ["--help"], env={"COLUMNS": "200"}).stdout.split())
    assert "Replace files that exist and are no results of pneu." in text
