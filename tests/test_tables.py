# SPDX-License-Identifier: Apache-2.0
"""Tables on a terminal of 80 columns: every name is there whole, on as many lines as it takes."""

import io
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console
from typer.testing import CliRunner

import pneu_sim.commands
from pneu_common.cli import build_app
from pneu_common.tables import Column, NamedTable
from pneu_policy.judge.results import rich_table
from pneu_policy.learn.command import _table as runs_table
from pneu_sim.effects import registry
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.command.diagnose import diagnosis_table
from pneu_sysid.command.fit import fitted_table, parameter_list
from pneu_sysid.command.tables import error_table, step_table
from pneu_sysid.compare import compare_table, recordings_table
from pneu_sysid.results.compare import (
    CompareResult,
    ModelError,
    Numerics,
    Regime,
    Series,
    Stretch,
    TapError,
)
from pneu_sysid.results.fit import FitResult, FittedParameter
from pneu_sysid.results.learn import Step

ROOT = Path(__file__).parent.parent
WIDTH = 80
TAPS = [f"pressure_at_the_{place}_end_of_the_long_tube" for place in ("near", "middle", "far")]
MODELS = ["rig_fitted_on_the_first_recording", "rig_with_a_leak[bold] at the far end"]
RECORDINGS = ["staircase_of_the_first_morning", "noise_of_the_second_afternoon"]
PATHS = [
    "valves.proportional_valve.ports.supply_of_the_left_arm.conductance_m3_s_pa",
    "pipes.tube_between_valve_and_the_left_actuator.wall.turbulent_fade",
]
EFFECTS = ["fill_exhaust_asymmetry_of_the_valve", "unsteady_friction_in_turbulent_flow"]
PLACES = ["tube_between_valve_and_actuator:12.345", "proportional_valve.supply_of_the_left_arm"]


def drawn(*tables, width=WIDTH) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=width, markup=False, emoji=False)
    for table in tables:
        console.print(table)
    return stream.getvalue()


def columns_of(text: str) -> list[str]:
    """What each column of each table says, its lines joined, without blanks."""
    out: list[str] = []
    for block in re.split(r"(?=[┏┌])", text):
        lines = [line for line in block.splitlines() if line[:1] in "│┃" and line]
        cells = [re.split("[│┃]", line)[1:-1] for line in lines]
        out += ["".join(column).replace(" ", "") for column in zip(*cells, strict=True)]
    return out


def check(text: str, names, width=WIDTH) -> None:
    assert "…" not in text and "..." not in text
    assert max(map(len, text.splitlines())) <= width
    found = columns_of(text)
    for name in names:
        assert any(name.replace(" ", "") in column for column in found), name


def error_of(worst: list[Stretch]) -> TapError:
    return TapError(
        rmse_pa=12345.6,
        rmse_atm=0.1218,
        normalised=0.1234,
        times_noise=49.87,
        bias_pa=-12345.6,
        lag_s=-0.01234,
        gain=1.234,
        noise_floor_pa=250.0,
        worst=worst,
    )


def compared(models=MODELS, taps=TAPS) -> CompareResult:
    labels = {"flow_direction": "exhaust", "opening": "proportional_valve_of_the_arm 10-50 % open"}
    doing = "voltage_of_the_proportional_valve 4.20 to 8.50 V, fill"
    worst = [Stretch(recording=RECORDINGS[1], start_s=1, end_s=2, rmse_pa=12345.6, doing=doing)]
    regimes = [
        Regime(
            kind=kind,
            label=label,
            tap=taps[-1],
            rmse_pa=12345.6,
            bias_pa=-12345.6,
            share=0.5,
            samples=100,
            times_noise=49.87,
        )
        for kind, label in labels.items()
    ]
    return CompareResult(
        pneu_version="0",
        recording="two recordings",
        recordings=RECORDINGS,
        rigs=models,
        taps=taps,
        noise_floor_pa={tap: 250.0 for tap in taps},
        models=[
            ModelError(
                name=name,
                model="thin_plate",
                file=None,
                taps={tap: error_of(worst) for tap in taps},
                regimes=regimes,
                rmse_pa=1.0,
                times_noise=1.0,
                by_recording={recording: 123.45 for recording in RECORDINGS},
            )
            for name in models
        ],
        numerics=Numerics(
            dx_m=None, refined_dx_m=None, change_pa={}, discretisation=False, sentence="No grid."
        ),
        series=Series(time_s=[], command={}, measured={}, model={}, segments=[]),
    )


def test_compare():
    text = drawn(compare_table(compared()))
    doing = "voltage_of_the_proportional_valve"
    check(text, [*TAPS, *MODELS, *RECORDINGS, doing, "proportional_valve_of_the_arm"])
    assert "measured minus model" in text
    # What remains is what matters: the error, beside the noise, and its sign.
    for word in ("-12346", "49.87", "12346"):
        assert word in text
    assert "not shown, for want of width" in text


def test_many_models_on_two_recordings():
    many = [f"{name}_{k}" for k in range(5) for name in MODELS]
    check(drawn(recordings_table(compared(many))), [*many, *RECORDINGS])


def test_fit():
    parameters = [
        FittedParameter(
            path=path,
            recording=recording,
            value=1.2345e-8,
            start=1.0e-8,
            std_error=1.2e-11,
            unit="m^3/(s Pa)",
            at_bound=True,
            identified=True,
            lower=0.0,
            upper=1.0,
        )
        for path in PATHS
        for recording in (None, *RECORDINGS)
    ]
    result = FitResult(
        pneu_version="0",
        recording="r",
        rigs=["rig"],
        taps=TAPS,
        noise_floor_pa={},
        rig="rig.yaml",
        output=None,
        parameters=parameters,
        correlations=[],
        condition=None,
        warnings=[],
        rmse_pa={},
        held_out_rmse_pa={},
        history=[],
    )
    text = drawn(fitted_table("rig fitted to r", result))
    check(text, [*PATHS, *(f"{PATHS[0]} in {name}" for name in RECORDINGS), "m^3/(s Pa)"])
    assert "1.2345e-08" in text and "1.2e-11" in text
    rig = Rig.model_construct(effects=[])
    listed = [FitParameter(path=path, lower=1.234e-9, upper=1.234e-7) for path in PATHS]
    check(drawn(parameter_list(rig, listed)), [*PATHS, "m^3/(s Pa)"])
    errors = {name: {tap: 123456.0 for tap in TAPS} for name in ("noise", "fitted", "held out")}
    check(drawn(error_table("error per tap", errors, {})), [*TAPS, "held out, Pa"])


def test_diagnose():
    unit = SimpleNamespace(unit="m^2, effective")  # one that needs no look at the rig
    finalists = [
        SimpleNamespace(
            site=SimpleNamespace(
                effect=SimpleNamespace(name=effect, strength=unit),
                place=place,
                label=f"{effect}@{place}",
            ),
            rig=None,
            strength=1.23e-8,
            std_error=1e-10,
            score_explained=0.5,
            explained=0.5,
            held_out=0.5,
            t=123.4,
        )
        for effect in EFFECTS
        for place in PLACES
    ]
    labels = [one.site.label for one in finalists]
    found = SimpleNamespace(finalists=finalists, alike=lambda k: labels[:k])
    check(drawn(diagnosis_table(found)), [*EFFECTS, *PLACES, *labels[:3], "m^2, effective"])


@pytest.mark.parametrize("count", [3, 12])
def test_learn(count):
    taps = [f"{tap}_{k}" for tap in TAPS for k in range(count)]
    steps = [
        Step(
            step=k,
            added=added,
            place=place,
            strength=1.23e-8,
            unit="m^2, effective",
            std_error=1e-10,
            rmse_pa={},
            held_out_rmse_pa={tap: 123456.0 for tap in taps},
            total_times_noise=49.0,
            held_out_times_noise=49.87,
        )
        for k, (added, place) in enumerate(((None, None), *zip(EFFECTS, PLACES, strict=True)))
    ]
    labels = [f"{effect}@{place}" for effect, place in zip(EFFECTS, PLACES, strict=True)]
    check(drawn(step_table(steps, {})), [*taps, *labels, "49.87"])


def test_effects(monkeypatch):
    monkeypatch.setattr(pneu_sim.commands, "PLAIN_WIDTH", WIDTH)
    text = CliRunner().invoke(build_app(), ["effects"]).stdout
    effects = registry()
    check(text, [*effects, *(effect.strength.name for effect in effects.values())])


def test_check(monkeypatch, tmp_path):
    monkeypatch.setattr(pneu_sim.commands, "PLAIN_WIDTH", WIDTH)
    name = "line_between_the_valve_and_the_left_actuator"
    rig = (ROOT / "rigs" / "rig_a.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(rig.replace("tube", name), encoding="utf-8")
    done = CliRunner().invoke(build_app(), ["check", str(tmp_path / "rig.yaml")])
    assert done.exit_code == 0, done.output
    text = done.stdout[done.stdout.index("┏") :]
    assert "…" not in text
    assert any(name in column for column in columns_of(text))


def test_evaluate_and_train():
    heads = ["plant", *(f"controller_of_the_{k}th_training_with_noise" for k in range(8))]
    body = [[f"emulated_lab_with_hidden_effects, {k}", *["0.123 ± 0.004"] * 8] for k in "ab"]
    check(drawn(rich_table("errors", heads, body)), [*heads, *(row[0] for row in body)])
    run = SimpleNamespace(name="seed-1_iterations-1000_noise-250_delay-0.004_long-name")
    row = {
        "iteration": 1000,
        "samples": 123456789,
        "eval_score": -123.45,
        "eval_rmse": 0.1234,
        "wall_s": 12345.0,
    }
    history = SimpleNamespace(rows=[row], learned=lambda: row, unit="atm", mark=0.1)
    check(drawn(runs_table([SimpleNamespace(run=run, history=history)])), [run.name])


def test_brackets_in_names_are_brackets():
    table = NamedTable("of [red]", [Column("[bold]name"), Column("number", "number")], "a [note]")
    table.add_row("[italic]x", "1")
    with pytest.raises(ValueError, match="found 1 cells, needed are 2"):
        table.add_row("x")
    stream = io.StringIO()
    Console(file=stream, width=40).print(table)
    for text in ("of [red]", "[bold]name", "[italic]x", "a [note]"):
        assert text in stream.getvalue()


def test_a_wide_terminal_shows_everything_on_single_lines():
    text = drawn(compare_table(compared(["short"], ["near", "far"])), width=140)
    assert "not shown" not in text
    for heading in ("RMSE Pa", "% of std", "x noise", "share %"):
        assert heading in text
