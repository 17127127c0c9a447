# SPDX-License-Identifier: Apache-2.0
"""The actions `node` and `executable` of a launch file, made into command lines."""

import os
from pathlib import Path
from typing import Any

from pneu_common.documents import parse_yaml
from pneu_common.errors import InputError
from pneu_graph.launch.document import Entity
from pneu_graph.launch.process_spec import SIGKILL_TIMEOUT_S, SIGTERM_TIMEOUT_S, ProcessSpec
from pneu_graph.launch.scope import Scope
from pneu_graph.launch.substitution import split_words, substitute, truth
from pneu_graph.tools.executables import command_of
from pneu_graph.tools.message_text import yaml_text

_OF_PROCESS = (
    "if",
    "unless",
    "name",
    "cwd",
    "env",
    "output",
    "respawn",
    "respawn_delay",
    "respawn_max_retries",
    "on_exit",
    "sigterm_timeout",
    "sigkill_timeout",
    "launch-prefix",
    "emulate_tty",
    "shell",
)
_OUTPUTS = {
    "screen": frozenset({"stdout", "stderr"}),
    "both": frozenset({"stdout", "stderr"}),
    "full": frozenset({"stdout", "stderr"}),
    "log": frozenset({"stderr"}),
    "own_log": frozenset[str](),
}

# `ros2 launch` reads values as YAML 1.1, where these are no texts.
_TRUTH_WORDS = {"yes": True, "on": True, "no": False, "off": False}


def node(entity: Entity, scope: Scope, number: int, scratch: Path) -> ProcessSpec:
    """Returns the process of a `node`.

    Args:
        entity: The action.
        scope: Where it stands.
        number: Of the process, for its label.
        scratch: Folder for parameter files.

    Raises:
        InputError: A key is unknown, or the executable does not exist.
        ValueError: A substitution fails.
    """
    entity.check(
        (*_OF_PROCESS, "namespace", "exec_name", "param", "remap", "args", "ros_args"),
        ("pkg", "exec"),
    )
    package = substitute(entity.text("pkg"), scope)
    executable_name = substitute(entity.text("exec"), scope)
    name = substitute(entity.text("name"), scope)
    namespace = joined_namespace(scope.namespace, substitute(entity.text("namespace"), scope))
    command = command_of(package, executable_name)
    command += [*split_words(entity.text("args"), scope), "--ros-args"]
    command += split_words(entity.text("ros_args"), scope)
    if name:
        command += ["-r", f"__node:={name}"]
    if namespace:
        command += ["-r", f"__ns:={namespace}"]
    target = f"{namespace.rstrip('/')}/{name}" if name else "/**"
    files = _parameter_files(entity, scope, target, scratch, f"{executable_name}_{number}")
    command += [word for file in files for word in ("--params-file", str(file))]
    for source, destination in [*scope.remaps, *_remaps(entity, scope)]:
        command += ["-r", f"{source}:={destination}"]
    label = substitute(entity.text("exec_name"), scope) or executable_name
    return _process(entity, scope, f"{label}-{number}", command)


def executable(entity: Entity, scope: Scope, number: int) -> ProcessSpec:
    """Returns the process of an `executable`.

    Args:
        entity: The action.
        scope: Where it stands.
        number: Of the process, for its label.

    Raises:
        InputError: A key is unknown.
        ValueError: A substitution fails.
    """
    entity.check((*_OF_PROCESS, "args"), ("cmd",))
    shell = truth(substitute(entity.text("shell", "false"), scope))
    if shell:
        text = f"{substitute(entity.text('cmd'), scope)} {substitute(entity.text('args'), scope)}"
        command = [text.strip()]
    else:
        command = split_words(entity.text("cmd"), scope) + split_words(entity.text("args"), scope)
    if not command or not command[0]:
        raise entity.fault("cmd is empty", "cmd")
    label = substitute(entity.text("name"), scope) or os.path.basename(command[0].split()[0])
    return _process(entity, scope, f"{label}-{number}", command)


def joined_namespace(base: str, name: str) -> str:
    """Returns the absolute namespace inside another; one that is absolute replaces it.

    Args:
        base: Namespace around; empty: none.
        name: Namespace to enter; empty: none.
    """
    if not name:
        return base
    return name if name.startswith("/") else f"{base.rstrip('/')}/{name}"


def parameter_value(entity: Entity, scope: Scope) -> Any:
    """Returns the value of a parameter; a text is read as YAML, unless its type is ``str``.

    Args:
        entity: Entity with the keys `value` and, if wanted, `type`.
        scope: Where it stands.

    Raises:
        InputError: No parameter can hold it.
    """
    value = _plain_value(entity.value("value"), scope, entity.text("type") == "str")
    fits = isinstance(value, bool | int | float | str) or (
        isinstance(value, list)
        and all(isinstance(item, bool | int | float | str) for item in value)
    )
    if not fits:
        raise entity.fault(
            f"a parameter is a scalar or a list of scalars, found {value!r}", "value"
        )
    return value


def _plain_value(value: Any, scope: Scope, as_text: bool) -> Any:
    if isinstance(value, list):
        return [_plain_value(item, scope, as_text) for item in value]
    if not isinstance(value, str):
        if isinstance(value, float):
            return float(value)
        return str(value) if as_text else value
    text = substitute(value, scope)
    if as_text:
        return text
    if text.lower() in _TRUTH_WORDS:
        return _TRUTH_WORDS[text.lower()]
    try:
        found = parse_yaml(text, "value", "value")
    except InputError:
        return text
    return found if isinstance(found, bool | int | float | str | list) else text


def _parameter_files(
    entity: Entity, scope: Scope, target: str, scratch: Path, stem: str
) -> list[Path]:
    """Parameter files in the order in which they apply: the later ones win."""
    files: list[Path] = []

    def write(values: dict[str, Any], name: str) -> None:
        path = scratch / f"{stem}_{len(files)}.yaml"
        path.write_text(yaml_text({name: {"ros__parameters": values}}), encoding="utf-8")
        files.append(path)

    if scope.parameters:
        write(dict(scope.parameters), "/**")
    for part in entity.parts("param"):
        if part.has("from"):
            part.check(("allow_substs",), ("from",))
            path = Path(substitute(part.text("from"), scope))
            path = path if path.is_absolute() else Path.cwd() / path
            if not path.is_file():
                raise part.fault(f"no parameter file {path}", "from")
            if truth(substitute(part.text("allow_substs", "false"), scope)):
                copy = scratch / f"{stem}_{len(files)}.yaml"
                copy.write_text(
                    substitute(path.read_text(encoding="utf-8"), scope), encoding="utf-8"
                )
                path = copy
            files.append(path)
        else:
            write(_nested(part, scope), target)
    return files


def _nested(part: Entity, scope: Scope, prefix: str = "") -> dict[str, Any]:
    part.check(("value", "type", "param"), ("name",))
    name = prefix + substitute(part.text("name"), scope)
    if part.has("param") == part.has("value"):
        raise part.fault(f"{name!r} has one of 'value' and 'param'")
    if part.has("value"):
        return {name: parameter_value(part, scope)}
    values: dict[str, Any] = {}
    for inner in part.parts("param"):
        values.update(_nested(inner, scope, f"{name}."))
    return values


def _remaps(entity: Entity, scope: Scope) -> list[tuple[str, str]]:
    remaps = []
    for part in entity.parts("remap"):
        part.check((), ("from", "to"))
        remaps.append((substitute(part.text("from"), scope), substitute(part.text("to"), scope)))
    return remaps


def _process(entity: Entity, scope: Scope, label: str, command: list[str]) -> ProcessSpec:
    def seconds(key: str, default: float) -> float:
        text = substitute(entity.text(key, str(default)), scope)
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if value < 0.0:
            raise entity.fault(f"{key} is a number of seconds, found {text!r}", key)
        return value

    def yes(key: str) -> bool:
        return truth(substitute(entity.text(key, "false"), scope))

    output = substitute(entity.text("output", "log"), scope)
    if output not in _OUTPUTS:
        raise entity.fault(f"output is one of {', '.join(_OUTPUTS)}, found {output!r}", "output")
    on_exit = substitute(entity.text("on_exit"), scope)
    if on_exit not in ("", "shutdown"):
        raise entity.fault(f"on_exit is 'shutdown', found {on_exit!r}", "on_exit")
    environment = dict(scope.environment)
    for part in entity.parts("env"):
        part.check((), ("name", "value"))
        environment[substitute(part.text("name"), scope)] = substitute(part.text("value"), scope)
    environment.setdefault("PYTHONUNBUFFERED", "1")  # else lines come late through the pipe
    prefix = split_words(entity.text("launch-prefix"), scope)
    retries = substitute(entity.text("respawn_max_retries", "-1"), scope)
    if not retries.lstrip("-").isdigit():
        raise entity.fault(f"respawn_max_retries is a whole number, found {retries!r}")
    return ProcessSpec(
        label=label,
        command=prefix + command,
        environment=environment,
        directory=substitute(entity.text("cwd"), scope) or None,
        screen=_OUTPUTS[output],
        shell=yes("shell"),
        delay_s=scope.delay_s,
        respawn=yes("respawn"),
        respawn_delay_s=seconds("respawn_delay", 0.0),
        respawn_max_retries=int(retries),
        shutdown_on_exit=on_exit == "shutdown",
        sigterm_timeout_s=seconds("sigterm_timeout", SIGTERM_TIMEOUT_S),
        sigkill_timeout_s=seconds("sigkill_timeout", SIGKILL_TIMEOUT_S),
    )
