# SPDX-License-Identifier: Apache-2.0
"""`pneu bag`: recording, playing, and looking into rosbag2 MCAP bags."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from pneu_common.errors import InputError
from pneu_common.files import check_name_is_text
from pneu_graph.bag.info import info_text
from pneu_graph.bag.reader import BagReader
from pneu_graph.bag.recover import recover_bag

app = typer.Typer(help="Record, play and inspect bags.", no_args_is_help=True)

Bag = Annotated[Path, typer.Argument(help="Folder of a bag, or an .mcap file.")]


@app.command("info")
def info(bag: Bag) -> None:
    """Shows what a bag holds."""
    print(info_text(BagReader(bag)))


@app.command("recover")
def recover(bag: Bag) -> None:
    """Completes a bag whose recorder was killed."""
    for sentence in recover_bag(bag):
        print(sentence)


@app.command("record")
def record(
    topics: Annotated[list[str] | None, typer.Argument(help="Topics; none: all.")] = None,
    everything: Annotated[bool, typer.Option("--all", "-a", help="Every topic.")] = False,
    output: Annotated[str, typer.Option("--output", "-o", help="Folder of the bag.")] = "",
    regex: Annotated[str, typer.Option("--regex", "-e", help="Topics that match.")] = "",
    exclude: Annotated[
        str, typer.Option("--exclude-regex", "-x", help="Topics to leave out.")
    ] = "",
    with_hidden: Annotated[
        bool, typer.Option("--include-hidden-topics", help="Hidden topics too.")
    ] = False,
    max_bag_size: Annotated[
        int, typer.Option("--max-bag-size", "-b", help="Size of a file, bytes; 0: no limit.")
    ] = 0,
    max_bag_duration: Annotated[
        float, typer.Option("--max-bag-duration", "-d", help="Of a file, s; 0: no limit.")
    ] = 0.0,
    max_cache_size: Annotated[
        int, typer.Option("--max-cache-size", help="Messages in memory, bytes.")
    ] = 100 * 1024 * 1024,
    snapshot_mode: Annotated[
        bool, typer.Option("--snapshot-mode", help="Write when ~/snapshot is called.")
    ] = False,
    use_sim_time: Annotated[
        bool, typer.Option("--use-sim-time", help="Log times from /clock.")
    ] = False,
    attach: Annotated[
        list[Path] | None, typer.Option("--attach", help="File kept in the bag; repeatable.")
    ] = None,
    operator: Annotated[str, typer.Option("--operator", help="Who records.")] = "",
    node_name: Annotated[str, typer.Option("--node-name", help="Name of the node.")] = "recorder",
) -> None:
    """Records topics until Ctrl-C."""
    from pneu_runtime import hook

    if not (topics or everything or regex):
        raise InputError("record: name topics, or say --all or --regex")
    for path in (output, *map(str, attach or ())):
        check_name_is_text(path, "a ROS parameter")
    hook.install()
    from pneu_graph.nodes import recorder

    values: dict[str, Any] = {
        "uri": output,
        "topics": list(topics or [""]),
        "all": everything,
        "regex": regex,
        "exclude": exclude,
        "include_hidden_topics": with_hidden,
        "max_bag_size": max_bag_size,
        "max_bag_duration": max_bag_duration,
        "max_cache_size": max_cache_size,
        "snapshot_mode": snapshot_mode,
        "use_sim_time": use_sim_time,
        "attachments": [str(path) for path in attach or ()] or [""],
        "operator": operator,
    }
    words = ["--ros-args", "-r", f"__node:={node_name}"]
    for name, value in values.items():
        words += ["-p", f"{name}:={json.dumps(value)}"]
    recorder.main(words)


@app.command("play")
def play(
    bag: Bag,
    rate: Annotated[float, typer.Option("--rate", "-r", help="Recorded s per s.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", "-l", help="Begin again at the end.")] = False,
    start_offset_s: Annotated[
        float, typer.Option("--start-offset", help="Where to begin, s.")
    ] = 0.0,
    duration_s: Annotated[
        float, typer.Option("--playback-duration", help="How much to play, s; 0: all.")
    ] = 0.0,
    delay_s: Annotated[float, typer.Option("--delay", "-d", help="Wait before, s.")] = 0.0,
    clock_hz: Annotated[
        float, typer.Option("--clock", help="Publish /clock so often, Hz; 0: not at all.")
    ] = 0.0,
    topics: Annotated[
        list[str] | None, typer.Option("--topics", help="Only this topic; repeatable.")
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option("--exclude-topics", help="Not this one; repeatable.")
    ] = None,
    remap: Annotated[
        list[str] | None, typer.Option("--remap", "-m", help="old:=new; repeatable.")
    ] = None,
    paused: Annotated[bool, typer.Option("--start-paused", "-p", help="Begin paused.")] = False,
) -> None:
    """Plays a bag."""
    from pneu_runtime import hook

    for rule in remap or []:
        if ":=" not in rule:
            raise InputError(f"--remap: is written old:=new, found {rule!r}")
    hook.install()
    from pneu_graph.nodes.player import PlayOptions, play_bag

    options = PlayOptions(
        rate=rate,
        loop=loop,
        start_offset_s=start_offset_s,
        duration_s=duration_s,
        clock_hz=clock_hz,
        topics=tuple(topics or ()),
        exclude=tuple(exclude or ()),
        paused=paused,
        delay_s=delay_s,
    )
    rules = [word for rule in remap or [] for word in ("-r", rule)]
    status = play_bag(bag, options, ["--ros-args", *rules] if rules else [])
    if status:
        raise typer.Exit(status)
