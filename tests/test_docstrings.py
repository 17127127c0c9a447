# SPDX-License-Identifier: Apache-2.0
"""Every public object has a docstring, and `Args:` names exactly the arguments there are.

The idea is python-control's docstring test. A module or name that starts with an underscore is
private. A parameter of a command-line function is documented by its help text.
"""

import dataclasses
import importlib
import inspect
import re
import typing
from pathlib import Path

import pytest
from tests.packages import PACKAGES

pytestmark = pytest.mark.kernel_free

SOURCES = Path(__file__).parent.parent / "src"

OPTIONAL = {"torch", "gymnasium", "stable_baselines3", "matplotlib"}
"""What only the extras of `pyproject.toml` bring."""

_ARGS_ENTRY = re.compile(r"(?P<names>\*{0,2}\w+(?:\s*[,/]\s*\*{0,2}\w+)*)\s*(?:\(.*\))?\s*:")


def public_modules():
    """Dotted names of all modules, found as files so that a broken one fails its own test only."""
    for package in PACKAGES:
        root = SOURCES / package
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            if "embedded" in parts:  # imported by the names of what it stands in for
                parts = parts[parts.index("embedded") + 1 :]
            if parts[-1] == "__init__":
                parts = parts[:-1]
            if not any(part.startswith("_") for part in parts):
                yield ".".join(parts)


def documented_names(docstring, section):
    """Names listed in a Google-style section, or None where there is no such section."""
    lines = inspect.cleandoc(docstring).splitlines()
    if f"{section}:" not in lines:
        return None
    body = []
    for line in lines[lines.index(f"{section}:") + 1 :]:
        if line and not line.startswith(" "):
            break
        body.append(line)
    indent = min((len(line) - len(line.lstrip()) for line in body if line.strip()), default=0)
    names = []
    for line in body:
        entry = _ARGS_ENTRY.match(line[indent:])
        if entry:
            names += [name.lstrip("*") for name in re.split(r"\s*[,/]\s*", entry["names"])]
    return names


def has_help_text(function, parameter):
    """Whether typer shows help for a parameter."""
    try:
        hint = typing.get_type_hints(function, include_extras=True).get(parameter.name)
    except Exception:  # a name that only type checkers can resolve; then it is no command
        return False
    declared = [parameter.default, *getattr(hint, "__metadata__", ())]
    return any(type(one).__module__.startswith("typer") and one.help for one in declared)


def faults_of_callable(name, function):
    """What is wrong with the docstring of one function or method."""
    function = getattr(function, "py_func", function)  # the source of a Numba kernel
    docstring = inspect.getdoc(function)
    if not docstring:
        return [f"{name} has no docstring"]
    parameters = [
        parameter
        for parameter in inspect.signature(function).parameters.values()
        if parameter.name not in ("self", "cls") and not parameter.name.startswith("_")
    ]
    documented = documented_names(docstring, "Args") or []
    actual = [parameter.name for parameter in parameters]
    faults = [
        f"{name}: argument '{parameter.name}' is not named under Args:"
        for parameter in parameters
        if parameter.name not in documented and not has_help_text(function, parameter)
    ]
    faults += [
        f"{name}: Args: names '{entry}', which is not an argument"
        for entry in documented
        if entry not in actual
    ]
    return faults


def faults_of_class(name, cls):
    """What is wrong with the docstrings of one class and its public methods."""
    own = cls.__dict__.get("__doc__")
    # dataclass writes the signature where there is no docstring, which documents nothing
    if not own or own.startswith(f"{cls.__name__}("):
        return [f"{name} has no docstring"]
    faults = []
    if dataclasses.is_dataclass(cls):
        attributes = {field.name for field in dataclasses.fields(cls)}
        attributes |= {key for base in cls.__mro__ for key in base.__dict__}
        for section in ("Attributes", "Args"):
            faults += [
                f"{name}: {section}: names '{entry}', which is not an attribute"
                for entry in documented_names(own, section) or []
                if entry not in attributes
            ]
    for key, member in cls.__dict__.items():
        if key == "__init__" and inspect.isfunction(member) and is_written_in(cls, member):
            member.__doc__ = member.__doc__ or own
            faults += faults_of_callable(f"{name}.__init__", member)
        if key.startswith("_"):
            continue
        member = getattr(member, "__func__", member)  # classmethod, staticmethod
        if isinstance(member, property):
            if not inspect.getdoc(getattr(cls, key)):
                faults.append(f"{name}.{key} has no docstring")
        elif inspect.isfunction(member) and is_written_in(cls, member):
            if not member.__doc__ and inspect.getdoc(getattr(cls, key)):
                continue  # an override that keeps the meaning documented in its base
            faults += faults_of_callable(f"{name}.{key}", member)
    return faults


def is_written_in(cls, function):
    """Whether a method stands in the source file, rather than being generated."""
    return function.__code__.co_filename == inspect.getsourcefile(cls)


def faults_of_module(module):
    """What is wrong with the docstrings of one module and all that it defines."""
    faults = [] if (module.__doc__ or "").strip() else [f"{module.__name__} has no docstring"]
    for key, member in vars(module).items():
        home = getattr(member, "__module__", None) or ""
        # what a private module defines is checked where a public one hands it out
        defined_here = home == module.__name__
        handed_out = home.startswith(PACKAGES) and "._" in home
        if key.startswith("_") or not (defined_here or handed_out):
            continue
        name = f"{module.__name__}.{key}"
        if inspect.isclass(member):
            faults += faults_of_class(name, member)
        elif inspect.isfunction(member) or hasattr(member, "py_func"):
            faults += faults_of_callable(name, member)
    return faults


@pytest.mark.parametrize("name", list(public_modules()))
def test_public_objects_are_documented(name):
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in OPTIONAL:
            raise
        pytest.skip(f"{error.name} is not installed")
    faults = faults_of_module(module)
    assert not faults, "\n" + "\n".join(faults)


def test_every_command_and_option_has_help():
    import typer.main

    from pneu_common.cli import build_app

    root = typer.main.get_command(build_app())
    silent = []
    for command in commands_of(root):
        if not command.help:
            silent.append(f"command '{command.name}' has no help text")
        silent += [
            f"'{parameter.name}' of '{command.name}' has no help text"
            for parameter in command.params
            if not getattr(parameter, "help", None)
        ]
    assert not silent, "\n" + "\n".join(silent)


def commands_of(command):
    """A command and all its subcommands."""
    yield command
    for child in getattr(command, "commands", {}).values():
        yield from commands_of(child)


# The checks themselves, shown on objects with a known fault.


def complete(length_m, *areas_m2, **options):
    """Do nothing.

    Args:
        length_m (float, shape (n,)): Length: along the line [m].
            A second line of text.
        *areas_m2: Areas [m2].
        **options: Ignored.

    Returns:
        None: always.
    """


def incomplete(length_m, area_m2):
    """Do nothing.

    Args:
        length_m: Length [m].
    """


def stale(length_m):
    """Do nothing.

    Args:
        length_m: Length [m].
        area_m2: Area [m2].
    """


def without_args_section(length_m):
    """Do nothing."""


def bare(length_m):
    pass


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (complete, []),
        (incomplete, ["f: argument 'area_m2' is not named under Args:"]),
        (stale, ["f: Args: names 'area_m2', which is not an argument"]),
        (without_args_section, ["f: argument 'length_m' is not named under Args:"]),
        (bare, ["f has no docstring"]),
    ],
)
def test_faults_are_found(function, expected):
    assert faults_of_callable("f", function) == expected


def test_option_with_help_counts_as_documented():
    import typer

    def command(
        new: typing.Annotated[int, typer.Option(help="Count.")] = 1,
        old: int = typer.Option(1, help="Count."),
        silent: typing.Annotated[int, typer.Option()] = 1,
    ):
        """Do nothing."""

    assert faults_of_callable("f", command) == ["f: argument 'silent' is not named under Args:"]


def test_faults_of_a_class_are_found():
    @dataclasses.dataclass
    class Undocumented:
        length_m: float

    @dataclasses.dataclass
    class Line:
        """A line.

        Attributes:
            length_m: Length [m].
            area_m2: Area [m2].
        """

        length_m: float

        def scaled(self, factor):
            """Return a scaled line."""

    assert faults_of_class("C", Undocumented) == ["C has no docstring"]
    assert faults_of_class("C", Line) == [
        "C: Attributes: names 'area_m2', which is not an attribute",
        "C.scaled: argument 'factor' is not named under Args:",
    ]
