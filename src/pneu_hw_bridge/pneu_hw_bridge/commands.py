# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `pneu`: `pneu lab`, the emulated lab, and what talks to it."""

import json
from pathlib import Path
from typing import Annotated

import typer

from pneu_common.documents import read_json
from pneu_common.errors import InputError
from pneu_common.options import MOST_SEED, Force
from pneu_common.outputs import check_output
from pneu_hw_bridge import stop_command
from pneu_hw_bridge.lab.asking import CONTROL_PORT, MODBUS_PORT, ask
from pneu_hw_bridge.lab.faults import KINDS

ControlPort = Annotated[
    int,
    typer.Option("--control-port", help="Control port of the running lab.", min=1, max=65535),
]
ReadyFile = Annotated[
    Path | None,
    typer.Option("--ready-file", help="Ready file of the running lab; tells its control port."),
]


def register(app: typer.Typer) -> None:
    """Adds the subcommands.

    Args:
        app: The `pneu` command.
    """
    lab = typer.Typer(
        help="Run an emulated lab: a Modbus device in front of a rig simulated in real time.",
        rich_markup_mode=None,
    )
    lab.callback(invoke_without_command=True)(run)
    lab.command("fault")(fault)
    lab.command("clear")(clear)
    lab.command("status")(status)
    lab.command("stand")(stand)
    lab.command("go")(go)
    lab.command("restart")(restart)
    lab.command("seal")(seal_effects)
    lab.command("reveal")(reveal)
    app.add_typer(lab, name="lab")
    app.command("stop")(stop)


def stop(
    reason: Annotated[str, typer.Option(help="Who calls for it, for the log.")] = "pneu stop",
    local: Annotated[
        bool, typer.Option("--local", help="Only the bridges of this machine; do not look further.")
    ] = False,
) -> None:
    """Stop: vent the valves of all bridges, of this machine at once, then of all on the graph.

    They stay vented, over a restart too, until each is reset (service ~/reset_e_stop). Exit status
    1 where one does not confirm that its valves are safe, or where there is no bridge.
    """
    raise typer.Exit(stop_command.stop(reason, local))


def run(
    _ctx: typer.Context,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file of the plant.")] = None,
    registers: Annotated[
        str, typer.Option(help="Register map: a YAML file or the name of a profile.")
    ] = "generic_plc",
    sealed: Annotated[
        Path | None, typer.Option(help="Sealed file with hidden effects (pneu lab seal).")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(help="Modbus TCP port; 0 takes a free one.", min=0, max=65535)
    ] = MODBUS_PORT,
    control_port: Annotated[
        int,
        typer.Option(
            help="Control port, always on loopback; 0 takes a free one.", min=0, max=65535
        ),
    ] = CONTROL_PORT,
    expose: Annotated[
        bool, typer.Option("--expose", help="Allow an address other than loopback.")
    ] = False,
    dx: Annotated[
        float | None,
        typer.Option(help="Cell length of the plant, m.", show_default="half of the rig's"),
    ] = None,
    sample: Annotated[
        float, typer.Option(help="Interval of the plant's samples and of the device's outputs, s.")
    ] = 1e-3,
    period: Annotated[
        float, typer.Option(help="Interval of the samples of a device with a clock, s.")
    ] = 2e-3,
    paced: Annotated[
        float | None,
        typer.Option(
            help="Seconds of device time per second, at most 1, of a device with a clock. Its time"
            " waits for the machine and for its reader instead of being real time.",
            show_default="real time",
        ),
    ] = None,
    standing: Annotated[
        bool, typer.Option("--standing", help="With --paced: time stands still until lab go.")
    ] = False,
    latency: Annotated[float, typer.Option(help="Age at which a reading shows, s.")] = 2e-3,
    noise: Annotated[
        float | None, typer.Option(help="Sensor noise, Pa.", show_default="the rig's")
    ] = None,
    quantum: Annotated[
        float | None, typer.Option(help="Sensor resolution, Pa.", show_default="the rig's")
    ] = None,
    watchdog: Annotated[
        float | None,
        typer.Option(help="The device's own watchdog, s.", show_default="the register map's"),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=MOST_SEED)] = 0,
    allow_slow: Annotated[
        bool, typer.Option("--allow-slow", help="Start even if real time cannot be kept.")
    ] = False,
    ready_file: Annotated[
        Path | None, typer.Option(help="File that is written once the lab can be used.")
    ] = None,
) -> None:
    """Run an emulated lab: a Modbus device in front of a rig simulated in real time."""
    if _ctx.invoked_subcommand is not None:
        return
    if rig is None:
        raise InputError("pneu lab: needs --rig, a rig file")
    # Here, so that the other commands of `pneu` do not wait for the simulator to be loaded.
    from pneu_hw_bridge.lab.lab import LabOptions, run_lab

    run_lab(
        LabOptions(
            rig=rig,
            registers=registers,
            sealed=sealed,
            host=host,
            port=port,
            control_port=control_port,
            expose=expose,
            dx_m=dx,
            sample_s=sample,
            period_s=period,
            pace=paced,
            standing=standing,
            latency_s=latency,
            noise_pa=noise,
            quantum_pa=quantum,
            watchdog_s=watchdog,
            seed=seed,
            allow_slow=allow_slow,
            ready_file=ready_file,
        )
    )


def fault(
    name: Annotated[
        str | None, typer.Argument(help="Kind of fault; without it they are listed.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="How long, s.", show_default="until cleared")
    ] = None,
    value: Annotated[float | None, typer.Option(help="Its number: delay, code or reading.")] = None,
    channel: Annotated[str, typer.Option(help="The sensor it sits at; all without.")] = "",
    control_port: ControlPort = CONTROL_PORT,
    ready_file: ReadyFile = None,
) -> None:
    """Begin a fault of a running lab, or list the kinds of fault."""
    if name is None:
        for kind in KINDS.values():
            number = f"; --value: {kind.value[0]} ({kind.value[1]:g})" if kind.value else ""
            print(f"{kind.name:14}{kind.title}{number}")
        return
    request = {
        "do": "fault",
        "name": name,
        "seconds": seconds,
        "value": value,
        "channel": channel,
    }
    ask(_control_port(control_port, ready_file), request)


def clear(
    name: Annotated[str, typer.Argument(help="Kind of fault; all without.")] = "",
    control_port: ControlPort = CONTROL_PORT,
    ready_file: ReadyFile = None,
) -> None:
    """End a fault of a running lab, or all of them."""
    ask(_control_port(control_port, ready_file), {"do": "clear", "name": name})


def status(control_port: ControlPort = CONTROL_PORT, ready_file: ReadyFile = None) -> None:
    """Show how a running lab is doing, as JSON."""
    answer = ask(_control_port(control_port, ready_file), {"do": "status"})
    answer.pop("ok")
    print(json.dumps(answer, indent=2))


def stand(control_port: ControlPort = CONTROL_PORT, ready_file: ReadyFile = None) -> None:
    """Have the time of a paced lab stand still."""
    ask(_control_port(control_port, ready_file), {"do": "stand"})


def go(
    seconds: Annotated[
        float | None, typer.Option(help="How long, device time, s.", show_default="for good")
    ] = None,
    control_port: ControlPort = CONTROL_PORT,
    ready_file: ReadyFile = None,
) -> None:
    """Have the time of a paced lab pass again."""
    ask(_control_port(control_port, ready_file), {"do": "go", "seconds": seconds})


def restart(control_port: ControlPort = CONTROL_PORT, ready_file: ReadyFile = None) -> None:
    """Have clock, counters and outputs of a lab's device begin anew, as after a loss of supply."""
    ask(_control_port(control_port, ready_file), {"do": "restart"})


def seal_effects(
    effects: Annotated[
        Path,
        typer.Argument(
            help="YAML list of effect, place, parameters; or what is hidden of a hand (pneu_truth)."
        ),
    ],
    output: Annotated[Path, typer.Argument(help="The sealed file.")],
    force: Force = False,
) -> None:
    """Hide effects in a file that shows nothing at a glance."""
    from pneu_common.documents import read_yaml
    from pneu_hw_bridge.hand_lab.hidden import seal_truth
    from pneu_hw_bridge.lab.sealed import read_effects, seal
    from pneu_sim.hand.truth import read_truth

    check_output(output, force)
    data = read_yaml(effects, "list of effects")
    if isinstance(data, dict) and "pneu_truth" in data:
        seal_truth(read_truth(effects), output)
    else:
        seal(read_effects(effects), output)


def reveal(
    sealed: Annotated[Path, typer.Argument(help="Sealed file.")],
) -> None:
    """Show what a sealed file hides."""
    from pneu_hw_bridge.hand_lab.hidden import open_truth
    from pneu_hw_bridge.lab.sealed import open_sealed
    from pneu_hw_bridge.sealing import open_values

    if isinstance(open_values(sealed, "list of effects"), dict):
        for line in open_truth(sealed).lines():
            print(line)
        return
    for effect in open_sealed(sealed):
        numbers = ", ".join(f"{name}={value:g}" for name, value in effect.parameters.items())
        print(f"{effect.effect}@{effect.place} {numbers}".rstrip())


def _control_port(port: int, ready_file: Path | None) -> int:
    if ready_file is None:
        return port
    ready = read_json(ready_file, "ready file of a running lab")
    found = ready.get("control_port") if isinstance(ready, dict) else None
    if not isinstance(found, int) or not 0 < found < 65536:
        raise InputError(f"{ready_file}: is not the ready file of a running lab")
    return found
