# SPDX-License-Identifier: Apache-2.0
"""Makes `import rclpy` and the imports of messages work on a machine without ROS.

`install()` chooses between the genuine rclpy and the embedded runtime, once for a process and all
that it starts: the choice is kept in the environment variable PNEU_RCLPY, which also overrides it.

- `PNEU_RCLPY` is not set: the genuine rclpy where it and `pneu_msgs` can be imported; the embedded
  runtime otherwise. Where a genuine rclpy is found but not used, one line on stderr gives the
  reason. Its messages need type support that only the genuine generators make, so that `pneu_msgs`
  of our own cannot stand in.
- `ros`: the genuine rclpy, or an error that gives the reason.
- `embedded`: the embedded runtime.

With the genuine rclpy the import system stays as it is. The embedded runtime is a finder that
provides `rclpy` and the other packages in `embedded/`, and `<package>.msg`, `.srv` and `.action` of
every interface package whose definitions are known. It prefers a package that is really installed,
unless that lies beside a genuine rclpy that is not used.
"""

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import sys
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_runtime.interfaces import action_class, known_types, message_class, service_class
from pneu_runtime.interfaces.catalogue import registry

CHOICE = "PNEU_RCLPY"
"""Environment variable with the choice: `ros` or `embedded`."""

_EMBEDDED = Path(__file__).parent / "embedded"
_KINDS = ("msg", "srv", "action")
_CLASS_OF = {"msg": message_class, "srv": service_class, "action": action_class}


class _InterfaceLoader(importlib.abc.Loader):
    """Makes the modules of an interface package; classes are made when first used."""

    holds_interfaces = True  # see `pneu_common.interfaces`

    def __init__(self, package: str, kind: str = "") -> None:
        self._package = package
        self._kind = kind

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType | None:
        return None

    def exec_module(self, module: types.ModuleType) -> None:
        package, kind = self._package, self._kind
        if not kind:
            module.__doc__ = f"Interfaces of the package {package}."
            return
        prefix = f"{package}/{kind}/"
        names = [name.removeprefix(prefix) for name in known_types() if name.startswith(prefix)]

        def get_class(name: str) -> Any:
            full = prefix + name
            if name in names:
                found: Any = _CLASS_OF[kind](full)
            elif kind != "msg" and "_" in name and name.split("_")[0] in names:
                found = _part(full)
            else:
                raise AttributeError(
                    f"module '{package}.{kind}' has no attribute '{name}'; it has: "
                    + ", ".join(names)
                )
            setattr(module, name, found)
            return found

        module.__doc__ = f"Classes of the {kind} definitions of the package {package}."
        module.__dict__["__all__"] = names
        module.__dict__["__getattr__"] = get_class
        module.__dict__["__dir__"] = lambda: [*module.__dict__, *names]


def _part(name: str) -> Any:
    """A part of a service or an action, such as `Trigger_Request` or `Identify_SendGoal`."""
    return service_class(name) if registry().is_service(name) else message_class(name)


def _provided() -> set[str]:
    """Return the names of the packages that the embedded runtime provides."""
    embedded = {path.parent.name for path in _EMBEDDED.glob("*/__init__.py")}
    return embedded | {name.split("/")[0] for name in known_types()}


class _Finder(importlib.abc.MetaPathFinder):
    """Finds what this package provides, unless something real is installed under that name."""

    def __init__(self, broken: Path | None = None) -> None:
        self._broken = broken  # where the packages of a ROS that is not used lie
        self._packages = {name.split("/")[0] for name in known_types()}
        self._embedded = {path.parent.name: path for path in _EMBEDDED.glob("*/__init__.py")}

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: types.ModuleType | None = None,
    ) -> importlib.machinery.ModuleSpec | None:
        package, _, kind = fullname.partition(".")
        if package in self._embedded and not kind:
            if self._is_installed(fullname, path):
                return None
            file = self._embedded[package]
            return importlib.util.spec_from_file_location(
                fullname, file, submodule_search_locations=[str(file.parent)]
            )
        if package not in self._packages or (kind and kind not in _KINDS):
            return None
        if self._is_installed(fullname, path):
            return None
        loader = _InterfaceLoader(package, kind)
        return importlib.machinery.ModuleSpec(fullname, loader, is_package=not kind)

    def _is_installed(self, name: str, path: Sequence[str] | None) -> bool:
        origin = _origin(name, path)
        if origin is None:
            return False
        return self._broken is None or self._broken not in Path(origin).parents


def _origin(name: str, path: Sequence[str] | None) -> str | None:
    """Where another finder knows a module; None if none does.

    A mere folder of that name, such as the one with the message definitions in a workspace, which
    Python would take for a namespace package, does not count.
    """
    for finder in sys.meta_path:
        if isinstance(finder, _Finder):
            continue
        find = getattr(finder, "find_spec", None)
        spec = find(name, path, None) if find else None
        if spec is not None and spec.loader is not None and spec.origin is not None:
            return spec.origin
    return None


def _genuine_fails() -> str:
    """Return why the genuine rclpy that is found cannot run our nodes; empty where it can."""
    before = set(sys.modules)
    try:
        importlib.import_module("rclpy")
        for kind in _KINDS:
            module = importlib.import_module(f"pneu_msgs.{kind}")
            prefix = f"pneu_msgs/{kind}/"
            for name in (n.removeprefix(prefix) for n in known_types() if n.startswith(prefix)):
                if not hasattr(module, name):
                    raise ImportError(f"pneu_msgs lacks {prefix}{name}: it is of another version")
    except Exception as error:
        # The genuine rclpy imports messages; they must not stay where ours are to be imported.
        ours = _provided()
        for module_name in set(sys.modules) - before:
            if module_name.partition(".")[0] in ours:
                del sys.modules[module_name]
        return f"{type(error).__name__}: {error}"
    return ""


def install() -> bool:
    """Make `rclpy` and messages importable. Further calls change nothing.

    Returns:
        Whether `import rclpy` gives the embedded runtime; False where it gives the genuine one.

    Raises:
        InputError: PNEU_RCLPY has another value, or asks for a genuine rclpy that cannot be used.
    """
    if any(isinstance(finder, _Finder) for finder in sys.meta_path):
        return True
    choice = os.environ.get(CHOICE, "")
    if choice not in ("", "ros", "embedded"):
        raise InputError(f"{CHOICE}: found {choice!r}, allowed are 'ros' and 'embedded'")
    if sys.modules.get("rclpy") is not None:  # a program of the user's has imported it
        return False
    origin = _origin("rclpy", None)
    if choice != "embedded" and origin is not None:
        why = _genuine_fails()
        if not why:
            os.environ[CHOICE] = "ros"
            return False
        if choice == "":
            print(
                f"pneu: the rclpy in {Path(origin).parent.parent} is not used ({why}); nodes run on"
                f" the embedded runtime ({CHOICE}=embedded says so beforehand, {CHOICE}=ros forbids"
                " it)",
                file=sys.stderr,
            )
    else:
        why = "no rclpy is installed"
    if choice == "ros":
        raise InputError(
            f"{CHOICE}=ros asks for the genuine rclpy, which cannot be used here: {why}; it and"
            " pneu_msgs have to be importable, see docs/runtime.md"
        )
    os.environ[CHOICE] = "embedded"
    # Before the finder of files, which would take a folder of definitions for a package; what
    # is really installed is still preferred, see `_is_installed`.
    files = [finder for finder in sys.meta_path if finder is importlib.machinery.PathFinder]
    position = sys.meta_path.index(files[0]) if files else len(sys.meta_path)
    sys.meta_path.insert(position, _Finder(Path(origin).parent.parent if origin else None))
    return True
