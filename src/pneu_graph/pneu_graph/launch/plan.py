# SPDX-License-Identifier: Apache-2.0
"""Carrying out a launch file: from its actions to the processes that are to run.

Scopes are those of `ros2 launch`: what `let`, `set_env`, `set_parameter` and `push_ros_namespace`
do ends with the group they stand in, and an included file without a group shares the scope.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from pneu_common.errors import InputError
from pneu_graph.launch import node_action
from pneu_graph.launch.document import Entity, LaunchError, load_launch_file
from pneu_graph.launch.process_spec import ProcessSpec
from pneu_graph.launch.scope import Scope
from pneu_graph.launch.substitution import substitute, truth

DEEPEST_INCLUDE = 32

REFUSED = {
    "node_container": "components are C++ libraries",
    "composable_node": "components are C++ libraries",
    "load_composable_node": "components are C++ libraries",
    "lifecycle_node": "start it as a node and use `lifecycle set`",
    "ros_timer": "use timer",
    "reset": "use a scoped group",
    "shutdown": "give a process on_exit: shutdown",
}
"""Actions of `ros2 launch` that are not carried out here."""

CONDITIONS = ("if", "unless")


@dataclasses.dataclass
class Argument:
    """A declared argument of a launch file.

    Attributes:
        name: Its name.
        default: Default as it stands in the file; None: it must be given.
        description: What it is for.
        choices: Allowed values; empty: any.
    """

    name: str
    default: str | None
    description: str
    choices: list[str]


class Plan:
    """The processes that a launch file asks for.

    Args:
        path: The launch file.
        arguments: Values given on the command line.
        environment: Environment of the processes.
        scratch: Folder for parameter files.
        log: Told what `log` actions say.

    Raises:
        InputError: The file is wrong, or an argument is missing, unknown or not allowed.
    """

    def __init__(
        self,
        path: Path,
        arguments: dict[str, str],
        environment: dict[str, str],
        scratch: Path,
        log: Callable[[str], None] = print,
    ) -> None:
        self.processes: list[ProcessSpec] = []
        self.arguments: dict[str, Argument] = {}
        self._scratch = scratch
        self._log = log
        self._given = arguments
        scope = Scope(dict(arguments), dict(environment), path.absolute())
        self._run(load_launch_file(path), scope)
        unknown = [name for name in arguments if name not in self.arguments]
        if unknown:
            raise InputError(
                f"{path}: argument {unknown[0]!r} is not declared; declared are"
                f" {', '.join(self.arguments) or 'none'}"
            )

    def _run(self, entities: list[Entity], scope: Scope) -> None:
        for entity in entities:
            kind = entity.kind.replace("-", "_")
            action = getattr(self, f"_do_{kind}", None)
            if action is None:
                if kind in REFUSED:
                    raise entity.fault(f"is not supported here; {REFUSED[kind]}")
                known = sorted(n.removeprefix("_do_") for n in dir(self) if n.startswith("_do_"))
                raise entity.fault(f"unknown action; known are {', '.join(known)}")
            try:
                if self._applies(entity, scope):
                    action(entity, scope)
            except ValueError as error:
                if isinstance(error, LaunchError):
                    raise
                raise entity.fault(str(error)) from None

    def _applies(self, entity: Entity, scope: Scope) -> bool:
        if entity.has("if") and entity.has("unless"):
            raise entity.fault("has both 'if' and 'unless', allowed is one")
        if entity.has("if"):
            return truth(substitute(entity.text("if"), scope))
        if entity.has("unless"):
            return not truth(substitute(entity.text("unless"), scope))
        return True

    def _do_arg(self, entity: Entity, scope: Scope) -> None:
        entity.check(("default", "description", "choice", *CONDITIONS), ("name",))
        name = entity.text("name")
        choices = []
        for choice in entity.parts("choice"):
            choice.check((), ("value",))
            choices.append(choice.text("value"))
        default = entity.text("default") if entity.has("default") else None
        self.arguments[name] = Argument(name, default, entity.text("description"), choices)
        if name not in scope.configurations:
            if default is None:
                about = f" ({entity.text('description')})" if entity.has("description") else ""
                raise entity.fault(f"{name!r}{about} has no default; give it as {name}:=value")
            scope.configurations[name] = substitute(default, scope)
        value = scope.configurations[name]
        if choices and value not in choices:
            raise entity.fault(f"{name!r} is one of {', '.join(choices)}, found {value!r}")

    def _do_let(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("name", "value"))
        scope.configurations[substitute(entity.text("name"), scope)] = substitute(
            entity.text("value"), scope
        )

    def _do_set_env(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("name", "value"))
        scope.environment[substitute(entity.text("name"), scope)] = substitute(
            entity.text("value"), scope
        )

    def _do_unset_env(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("name",))
        scope.environment.pop(substitute(entity.text("name"), scope), None)

    def _do_set_parameter(self, entity: Entity, scope: Scope) -> None:
        entity.check((*CONDITIONS, "type"), ("name", "value"))
        name = substitute(entity.text("name"), scope)
        scope.parameters.append((name, node_action.parameter_value(entity, scope)))

    def _do_set_use_sim_time(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("value",))
        value = truth(substitute(entity.text("value"), scope))
        scope.parameters.append(("use_sim_time", value))

    def _do_set_remap(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("from", "to"))
        scope.remaps.append(
            (substitute(entity.text("from"), scope), substitute(entity.text("to"), scope))
        )

    def _do_push_ros_namespace(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("namespace",))
        scope.namespace = node_action.joined_namespace(
            scope.namespace, substitute(entity.text("namespace"), scope)
        )

    def _do_log(self, entity: Entity, scope: Scope) -> None:
        entity.check((*CONDITIONS, "level"), ("message",))
        self._log(substitute(entity.text("message"), scope))

    def _do_group(self, entity: Entity, scope: Scope) -> None:
        scoped = True
        if isinstance(entity.data, dict):
            entity.check(("scoped", *CONDITIONS), ("children",))
            scoped = truth(substitute(entity.text("scoped", "true"), scope))
        self._run(entity.children(), scope.inner() if scoped else scope)

    def _do_timer(self, entity: Entity, scope: Scope) -> None:
        entity.check(CONDITIONS, ("period", "children"))
        inner = scope.inner()
        period = substitute(entity.text("period"), scope)
        try:
            inner.delay_s += float(period)
        except ValueError:
            raise entity.fault(f"period is a number of seconds, found {period!r}") from None
        self._run(entity.children(), inner)

    def _do_include(self, entity: Entity, scope: Scope) -> None:
        entity.check(("arg", "let", *CONDITIONS), ("file",))
        if scope.depth >= DEEPEST_INCLUDE:
            raise entity.fault(f"files include each other more than {DEEPEST_INCLUDE} deep")
        path = Path(substitute(entity.text("file"), scope))
        path = path if path.is_absolute() else entity.path.absolute().parent / path
        for part in entity.parts("arg") + entity.parts("let"):
            part.check((), ("name", "value"))
            scope.configurations[substitute(part.text("name"), scope)] = substitute(
                part.text("value"), scope
            )
        outer, scope.path, scope.depth = scope.path, path, scope.depth + 1
        try:
            self._run(load_launch_file(path), scope)
        finally:
            scope.path, scope.depth = outer, scope.depth - 1

    def _do_node(self, entity: Entity, scope: Scope) -> None:
        number = len(self.processes) + 1
        self.processes.append(node_action.node(entity, scope, number, self._scratch))

    def _do_executable(self, entity: Entity, scope: Scope) -> None:
        number = len(self.processes) + 1
        self.processes.append(node_action.executable(entity, scope, number))


def declared_arguments(path: Path) -> list[Argument]:
    """Returns the arguments that a launch file declares, also inside groups.

    Args:
        path: The launch file.

    Raises:
        InputError: The file is wrong.
    """

    def gather(entities: list[Entity]) -> list[Argument]:
        found = []
        for entity in entities:
            if entity.kind == "arg":
                entity.check(("default", "description", "choice", *CONDITIONS), ("name",))
                found.append(
                    Argument(
                        entity.text("name"),
                        entity.text("default") if entity.has("default") else None,
                        entity.text("description"),
                        [choice.text("value") for choice in entity.parts("choice")],
                    )
                )
            elif entity.kind in ("group", "timer"):
                found += gather(entity.children())
        return found

    return gather(load_launch_file(path))
