# SPDX-License-Identifier: Apache-2.0
"""Several recordings of one rig on the command line, and recordings that do not belong together."""

import json
from pathlib import Path

import numpy as np
import pytest
from studies.exact_rigs import draw_rig, record
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import Channel, Rig
from pneu_sysid.records.write import write_bag


def pneu(*words: object):
    return CliRunner().invoke(build_app(), [str(word) for word in words], prog_name="pneu")


def coarse(shape: str, rng: np.random.Generator) -> Rig:
    """A rig on cheap cells, for what takes many runs."""
    rig = draw_rig(shape, rng)
    rig.grid.dx_m, rig.grid.memory = 0.1, False
    return rig


def with_channels(rig: Rig) -> Rig:
    """The rig with a topic for each signal."""
    rig = rig.model_copy(deep=True)
    for name, command in rig.commands.items():
        command.channel = Channel(topic=f"/{name}", type="std_msgs/msg/Float64", field="data")
    for name, tap in rig.taps.items():
        tap.channel = Channel(
            topic=f"/taps/{name}", type="sensor_msgs/msg/FluidPressure", field="fluid_pressure"
        )
    return rig


@pytest.fixture(scope="module")
def rig_and_bags(tmp_path_factory):
    """A line, its rig file with two numbers wrong, and three recordings of it."""
    folder = tmp_path_factory.mktemp("several")
    rng = np.random.default_rng(21)
    rig = with_channels(coarse("line", rng))
    bags = []
    for k in range(3):
        recording = record(rig, rng, 125.0, 3.0, moving=k == 1, name=f"run_{k}")
        recording.start_time_s = 1.76e9 + 100.0 * k
        bags.append(folder / f"run_{k}.mcap")
        write_bag(bags[-1], rig, recording)
    wrong = rig.model_copy(deep=True)
    wrong.valves["valve"].spool.bandwidth_hz *= 1.2
    wrong.valves["valve"].ports["supply"].conductance_m3_s_pa *= 1.1
    path = "valves.valve.ports.supply.conductance_m3_s_pa"
    wrong.fit.parameters = Rig.model_validate(
        {
            **wrong.model_dump(by_alias=True),
            "fit": {
                "horizon_s": 0.5,
                "parameters": [
                    {"path": path, "lower": 1e-9, "upper": 5e-8, "log": True},
                    {"path": "valves.valve.spool.bandwidth_hz", "lower": 20, "upper": 200},
                ],
            },
        }
    ).fit.parameters
    file = folder / "rig.yaml"
    save_rig(wrong, file)
    return rig, file, bags


@pytest.mark.long
def test_a_calibration_on_two_is_better_on_a_third(rig_and_bags, tmp_path) -> None:
    _, file, bags = rig_and_bags
    fitted = {}
    for name, used in (("one", bags[:1]), ("other", bags[1:2]), ("both", bags[:2])):
        result = pneu("fit", *used, "--rig", file, "-o", tmp_path / f"{name}.yaml")
        assert result.exit_code == 0, result.output
        fitted[name] = load_rig(tmp_path / f"{name}.yaml")
    assert fitted["both"].calibration.recordings == ["run_0", "run_1"]
    truth = rig_and_bags[0].valves["valve"].ports["supply"].conductance_m3_s_pa

    def std_error(rig: Rig) -> float:
        return rig.fit.parameters[0].std_error

    # Two recordings tell more than either: a smaller standard error, and the truth within it.
    assert std_error(fitted["both"]) < min(std_error(fitted["one"]), std_error(fitted["other"]))
    both = fitted["both"].valves["valve"].ports["supply"].conductance_m3_s_pa
    assert abs(both - truth) < 4.0 * std_error(fitted["both"])

    out = tmp_path / "compare.json"
    words = [word for name in fitted for word in ("--rig", tmp_path / f"{name}.yaml")]
    result = pneu("compare", bags[2], *words, "--json", out)
    assert result.exit_code == 0, result.output
    models = {m["name"]: m["times_noise"] for m in json.loads(out.read_text())["models"]}
    assert models["both"] < 1.05


def test_compare_shows_every_model_on_every_recording(rig_and_bags, tmp_path) -> None:
    rig, file, bags = rig_and_bags
    save_rig(rig, tmp_path / "exact.yaml")
    out, page = tmp_path / "compare.json", tmp_path / "page.html"
    words = ["--rig", tmp_path / "exact.yaml", "--rig", file, "--no-refine"]
    result = pneu("compare", *bags, *words, "--json", out, "--report", page)
    assert result.exit_code == 0, result.output
    assert "every model on every recording" in result.output
    data = json.loads(out.read_text())
    assert data["recordings"] == ["run_0", "run_1", "run_2"]
    exact, wrong = data["models"]
    assert list(exact["by_recording"]) == data["recordings"]
    assert all(value < 1.1 for value in exact["by_recording"].values())
    assert all(value > 1.5 for value in wrong["by_recording"].values())
    assert {stretch["recording"] for stretch in exact["taps"]["end"]["worst"]} <= set(
        data["recordings"]
    )
    assert data["series"]["begins_s"][0] == 0.0 and len(data["series"]["begins_s"]) == 3
    assert page.stat().st_size > 10_000


def refused(result, *texts: object) -> None:
    assert result.exit_code == 2, result.output
    error = result.stderr.strip()
    assert error.startswith("pneu: ") and "\n" not in error, error
    for text in texts:
        assert str(text) in error


def test_the_same_recording_twice(rig_and_bags) -> None:
    _, file, bags = rig_and_bags
    refused(pneu("compare", bags[0], bags[0], "--rig", file), "'run_0'", "2 times")


def test_a_recording_of_another_rig(rig_and_bags, tmp_path) -> None:
    _, file, bags = rig_and_bags
    rng = np.random.default_rng(22)
    other = with_channels(coarse("tee", rng))
    strange = tmp_path / "strange.mcap"
    write_bag(strange, other, record(other, rng, 125.0, 1.0, moving=False, name="strange"))
    for command in ("compare", "diagnose"):
        refused(pneu(command, bags[0], strange, "--rig", file), "strange.mcap", "/taps/valve_out")
    assert Path(file).exists()


@pytest.mark.long
def test_a_rig_with_the_same_topics_is_noticed(rig_and_bags, tmp_path) -> None:
    rig, file, bags = rig_and_bags
    rng = np.random.default_rng(23)
    longer = rig.model_copy(deep=True)
    longer.pipes["tube"].length_m *= 1.5
    strange = tmp_path / "longer.mcap"
    write_bag(strange, longer, record(longer, rng, 125.0, 3.0, moving=False, name="longer"))
    result = pneu("fit", bags[0], strange, "--rig", file, "-o", tmp_path / "fitted.yaml")
    assert result.exit_code == 0, result.output
    assert "longer: the fitted rig leaves" in " ".join(result.output.split())
