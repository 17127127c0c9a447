# SPDX-License-Identifier: Apache-2.0
"""Launch files: what they ask for, and how their processes are run and ended."""

import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pneu_common.errors import InputError
from pneu_graph.launch.expression import evaluate
from pneu_graph.launch.plan import Plan, declared_arguments
from pneu_graph.launch.substitution import split_words, substitute

pytestmark = pytest.mark.kernel_free

NODE = "pkg: pneu_graph, exec: recorder"


def plan(tmp_path, text, environment=None, **arguments):
    path = tmp_path / "some_launch.yaml"
    path.write_text(text)
    said = []
    made = Plan(path, arguments, environment or {"PATH": os.environ["PATH"]}, tmp_path, said.append)
    made.said = said
    return made


def test_a_node_becomes_the_command_line_of_ros2_launch(tmp_path):
    (tmp_path / "common.yaml").write_text("/**: {ros__parameters: {a: 1}}\n")
    made = plan(
        tmp_path,
        """
launch:
- arg: {name: rate, default: "50.0"}
- push_ros_namespace: {namespace: rig}
- set_parameter: {name: use_sim_time, value: true}
- node:
    pkg: pneu_graph
    exec: recorder
    name: bag
    namespace: inner
    args: --flag "two words"
    ros_args: --log-level debug
    param:
    - {from: $(dirname)/common.yaml}
    - {name: rate_hz, value: $(var rate)}
    - {name: uri, value: "12", type: str}
    - name: limit
      param: [{name: low, value: 1}, {name: high, value: [1.0, 2.5]}]
    remap: [{from: a, to: /b}]
""",
    )
    (spec,) = made.processes
    words = spec.command[spec.command.index("recorder") + 1 :]
    files = [words[i + 1] for i, word in enumerate(words) if word == "--params-file"]
    assert [word for word in words if word not in files] == [
        "--flag", "two words", "--ros-args", "--log-level", "debug",
        "-r", "__node:=bag", "-r", "__ns:=/rig/inner",
        *["--params-file"] * 5, "-r", "a:=/b",
    ]  # fmt: skip
    contents = [YAML(typ="safe").load(Path(file).read_text()) for file in files]
    assert contents == [
        {"/**": {"ros__parameters": {"use_sim_time": True}}},
        {"/**": {"ros__parameters": {"a": 1}}},
        {"/rig/inner/bag": {"ros__parameters": {"rate_hz": 50.0}}},
        {"/rig/inner/bag": {"ros__parameters": {"uri": "12"}}},
        {"/rig/inner/bag": {"ros__parameters": {"limit.low": 1, "limit.high": [1.0, 2.5]}}},
    ]
    assert spec.label == "recorder-1"


def test_scopes_end_with_their_group(tmp_path):
    (tmp_path / "inner_launch.yaml").write_text(
        "launch:\n- arg: {name: colour}\n- log: {message: inner $(var colour) $(filename)}\n"
        "- let: {name: left_behind, value: shared}\n"
    )
    made = plan(
        tmp_path,
        """
launch:
- let: {name: x, value: outer}
- group:
  - let: {name: x, value: inside}
  - set_env: {name: COLOUR, value: red}
  - push-ros-namespace: {namespace: ns}
  - executable: {cmd: "echo $(var x) $(env COLOUR)"}
- group:
    scoped: false
    children:
    - let: {name: y, value: kept}
- executable: {cmd: "echo $(var x) $(var y) $(env COLOUR none)"}
- include: {file: inner_launch.yaml, arg: [{name: colour, value: blue}]}
- log: {message: "$(var left_behind) $(filename)"}
""",
    )
    assert [spec.command for spec in made.processes] == [
        ["echo", "inside", "red"],
        ["echo", "outer", "kept", "none"],
    ]
    assert made.processes[0].environment["COLOUR"] == "red"
    assert "COLOUR" not in made.processes[1].environment
    assert made.said == ["inner blue inner_launch.yaml", "shared some_launch.yaml"]


@pytest.mark.parametrize(("backend", "expected"), [("sim", ["a", "c"]), ("modbus", ["b", "c"])])
def test_conditions_choose(tmp_path, backend, expected):
    made = plan(
        tmp_path,
        """
launch:
- arg: {name: backend, choice: [{value: sim}, {value: modbus}]}
- executable: {cmd: a, if: "$(eval '\\"$(var backend)\\" == \\"sim\\"')"}
- executable: {cmd: b, unless: $(equals $(var backend) sim)}
- timer: {period: 1.5, children: [{executable: {cmd: c}}]}
""",
        backend=backend,
    )
    assert [spec.command[0] for spec in made.processes] == expected
    assert made.processes[-1].delay_s == 1.5


FAULTS = [
    (f"launch:\n- node:\n    {NODE.replace(', ', chr(10) + '    ')}\n    remaps: []\n",
     "line 5: node: unknown key 'remaps'; did you mean 'remap'?"),
    ("launch:\n\n- nodes: {}\n", "line 3: nodes: unknown action; known are arg,"),
    ("launch:\n- node: {pkg: a}\n", "line 2: node: key 'exec' is missing"),
    ("launch:\n- node: {pkg: no_such, exec: a}\n", "no executables of package 'no_such'"),
    ("launch:\n- node: {pkg: pneu_graph, exec: recorded}\n", "it has player, recorder"),
    ("launch:\n- arg: {name: a}\n", "'a' has no default; give it as a:=value"),
    ("launch:\n- arg: {name: a, default: z, choice: [{value: x}]}\n", "one of x, found 'z'"),
    ("launch:\n- log: {message: $(var nothing)}\n", "no argument or variable 'nothing'"),
    ("launch:\n- log: {message: $(command ls)}\n", "$(command) is not supported here"),
    ("launch:\n- log: {message: $(nonsense ls)}\n", "unknown substitution 'nonsense'"),
    ("launch:\n- log: {message: \"$(eval '__import__(1)')\"}\n", "calls __import__"),
    ("launch:\n- log: {message: $(find-pkg-share no_such_package)}\n", "is not installed"),
    ("launch:\n- log: {message: a, if: maybe}\n", "a condition is true, false, 1 or 0"),
    ("launch:\n- load_composable_node: {}\n", "is not supported here; components are C++"),
    ("launch:\n- executable: {cmd: a, output: paper}\n", "output is one of screen"),
    ("launch: {}\n- x", "is not YAML"),
    ("other: []\n", "mapping with the one key 'launch'"),
    ("launch:\n- include: {file: some_launch.yaml}\n", "include each other"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "sentence"), FAULTS)
def test_a_fault_is_one_sentence_with_file_and_line(tmp_path, text, sentence):
    with pytest.raises(InputError) as caught:
        plan(tmp_path, text)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "some_launch.yaml" in str(caught.value)


def test_an_argument_that_is_not_declared_is_refused(tmp_path):
    with pytest.raises(InputError, match="argument 'rte' is not declared; declared are rate"):
        plan(tmp_path, "launch:\n- arg: {name: rate, default: 1}\n", rte="2")


def test_arguments_are_listed_without_running(tmp_path):
    path = tmp_path / "a_launch.yaml"
    path.write_text("launch:\n- arg: {name: a}\n- group:\n  - arg: {name: b, default: $(var a)}\n")
    found = [(argument.name, argument.default) for argument in declared_arguments(path)]
    assert found == [("a", None), ("b", "$(var a)")]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3", 7),
        ("'a' == 'a' and not 2 > 3", True),
        ("sqrt(16) if 1 < 2 <= 2 else 0", 4.0),
        ("math.cos(0) + max(1, 2)", 3.0),
        ("'x' in ['x', 'y']", True),
        ("  7 - 2", 5),
        ("[7 / 2, 7 // 2, 7 % 4, 2 ** 3]", [3.5, 3, 3, 8]),
        ("[-3, +3, not 0, not 3]", [-3, 3, True, False]),
        ("[2 < 3, 3 < 3, 3 <= 3, 4 <= 3]", [True, False, True, False]),
        ("[3 > 2, 3 > 3, 3 >= 3, 3 >= 4]", [True, False, True, False]),
        ("[2 == 2, 2 == 3, 2 != 3, 2 != 2]", [True, False, True, False]),
        ("['z' in 'xy', 'z' not in 'xy', 'x' not in 'xy']", [False, True, False]),
        ("[1 < 2 < 3, 1 < 3 < 2, 3 < 1 < 2, 3 > 2 < 3]", [True, False, False, True]),
        ("[0 or 5, 4 or 1 / 0, 0 or '', 2 or 5 or 6]", [5, 4, "", 2]),
        ("[3 and 5, 0 and 1 / 0, 3 and '' and 5]", [5, 0, ""]),
        ("[1 if true else 2, 1 if false else 2]", [1, 2]),
        ("(True, 1.5, 'text', 4)", [True, 1.5, "text", 4]),
        ("[pi, math.pi, e, math.e]", [math.pi, math.pi, math.e, math.e]),
        ("[abs(-2), bool(0), float('1.5'), int('7'), len('abc')]", [2, False, 1.5, 7, 3]),
        ("[min(3, 2), max(2, 3), round(2.567, 1), str(3)]", [2, 3, 2.6, "3"]),
        ("[math.sqrt(16), atan2(1, 0), math.max(1, 2)]", [4.0, math.pi / 2.0, 2]),
        ("1" + 1999 * " ", 1),
        ("[2 ** 1000, 2.0 ** -1000]", [2**1000, 2.0**-1000]),
        ("[1000000 ** 2, (-1000000) ** 2]", [10**12, 10**12]),
        ("['a' * 100000, 50000 * 'ab'] == [100000 * 'a', 'ab' * 50000]", True),
        ("len([1, 2] * 50000)", 100_000),
    ],
)
def test_expressions(text, value):
    found = evaluate(text)
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1" + 2000 * " ", "is longer than 2000 characters"),
        ("().__class__", "uses '().__class__', which is not allowed"),
        ("'abc'[0]", "uses \"'abc'[0]\", which is not allowed"),
        ("open('x')", "calls open, which is not allowed"),
        ("'a'.upper()", "calls 'a'.upper, which is not allowed"),
        ("abs.max(1)", "calls abs.max, which is not allowed"),
        ("pi(1)", "calls pi, which is not allowed"),
        ("max(1, key=2)", "uses 'max(1, key=2)', which is not allowed"),
        ("max(*[1, 2])", "uses '*[1, 2]', which is not allowed"),
        ("[x for x in 'ab']", "uses \"[x for x in 'ab']\", which is not allowed"),
        ("lambda: 1", "uses 'lambda: 1', which is not allowed"),
        ("f'{1}'", "uses \"f'{1}'\", which is not allowed"),
        ("[1j, 2]", "uses '1j', which is not allowed"),
        ("None", "uses 'None', which is not allowed"),
        ("math.tan", "uses 'math.tan', which is not allowed"),
        ("math.none", "uses 'math.none', which is not allowed"),
        ("cmath.pi", "uses 'cmath.pi', which is not allowed"),
        ("1 + none", "uses the name 'none', which means nothing here"),
        ("max", "uses the name 'max', which means nothing here"),
        ("1 is 1", "uses Is, which is not allowed"),
        ("1 | 2", "uses '1 | 2', which is not allowed"),
        ("~1", "uses '~1', which is not allowed"),
        ("2 ** 1001", "raises 2 to 1001, which is too much"),
        ("2.0 ** -1001", "raises 2.0 to -1001, which is too much"),
        ("1000001 ** 2", "raises 1000001 to 2, which is too much"),
        ("(-1000001) ** 2", "raises -1000001 to 2, which is too much"),
        ("9**9**9", "raises 9 to 387420489, which is too much"),
        ("'a' * 100001", "makes a text that is too long"),
        ("50001 * 'ab'", "makes a text that is too long"),
        ("[1, 2] * 50001", "makes a text that is too long"),
        ("'%999999999d' % 1", "formats a text, which is not allowed"),
        ("factorial(100000)", "calls factorial, which is not allowed"),
        ("[math.comb(3, 2)]", "calls math.comb, which is not allowed"),
        ("perm(3, 2)", "calls perm, which is not allowed"),
        ("1 / 0", "cannot be computed (division by zero)"),
        ("exp(1000)", "cannot be computed (math range error)"),
        ("len(3)", "cannot be computed (object of type 'int' has no len())"),
        (1200 * "-" + "1", "cannot be computed (maximum recursion depth exceeded"),
        ("1 +", "is no expression (invalid syntax)"),
    ],
)
def test_expressions_can_only_compute(text, says):
    with pytest.raises(ValueError, match=f"^{re.escape(says)}"):
        evaluate(text)


class Scope:
    configurations: dict[str, str] = {"a": "two words", "b": "a"}  # noqa: RUF012
    environment: dict[str, str] = {"E": "e"}  # noqa: RUF012
    path = Path("/x/y.yaml")
    anonymous: dict[str, str] = {}  # noqa: RUF012


def test_substitutions_nest_and_are_not_split():
    assert substitute("<$(var $(var b))> $(env E) $(env F 'no f') \\$(x)", Scope()) == (
        "<two words> e no f $(x)"
    )
    assert split_words("x $(var a)/$(dirname) 'q r'", Scope()) == ["x", "two words//x", "q r"]


# Running.

LAUNCH = [sys.executable, "-c", "from pneu_graph.tools.launch_command import launch; import sys;"
          "sys.exit(launch(sys.argv[1:]))"]  # fmt: skip


@pytest.fixture
def start(tmp_path):
    started = []

    def begin(text):
        path = tmp_path / "some_launch.yaml"
        path.write_text(text)
        process = subprocess.Popen(
            [*LAUNCH, str(path)],
            env={**os.environ, "ROS_LOG_DIR": str(tmp_path / "log")},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.stdout.close()
        process.wait()


def read_until(process, wanted, timeout_s=10.0):
    """Lines of a process up to one that contains a text."""
    lines = []
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        line = process.stdout.readline()
        lines.append(line)
        if wanted in line:
            return lines
        assert line, f"ended without {wanted!r}: {''.join(lines)}"
    raise AssertionError(f"no {wanted!r} in {timeout_s} s: {''.join(lines)}")


def lives(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def wait_until(condition, timeout_s=8.0):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_output_has_the_prefix_of_its_process(start):
    process = start(
        """
launch:
- executable: {cmd: "sh -c 'echo hello; echo shown >&2; printf unfinished'", output: screen}
- executable: {cmd: "sh -c 'echo hidden; echo warned >&2'", name: quiet}
"""
    )
    out, _ = process.communicate(timeout=20)
    assert process.returncode == 0
    for line in ("[sh-1] hello", "[sh-1] shown", "[sh-1] unfinished", "[quiet-2] warned"):
        assert line in out.splitlines()
    assert "hidden" not in out
    assert "[INFO] [sh-1]: process has finished cleanly [pid " in out


def test_a_failed_process_makes_the_launch_fail(start):
    process = start(
        "launch:\n- executable: {cmd: \"sh -c 'exit 3'\"}\n- executable: {cmd: 'true'}\n"
    )
    out, _ = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "exit code 3, cmd 'sh -c" in out


def test_a_program_that_does_not_exist_is_named(start):
    process = start("launch:\n- executable: {cmd: no-such-program-here}\n")
    out, _ = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "[no-such-program-here-1]: cannot be started: no-such-program-here" in out


def test_sigint_is_passed_on_and_sigterm_follows(start):
    process = start(
        """
launch:
- executable:
    cmd: sh -c 'trap "echo got int; exit 0" INT; echo up; while :; do sleep 0.05; done'
    output: screen
- executable:
    cmd: sh -c 'trap "" INT; echo up; while :; do sleep 0.05; done'
    sigterm_timeout: 0.3
    output: screen
"""
    )
    read_until(process, "[sh-1] up")
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=20)
    assert "user interrupted with ctrl-c (SIGINT)" in out
    assert "[sh-1] got int" in out
    assert "[sh-2]: process[sh-2] failed to terminate '0.3' seconds" in out
    assert "sending signal 'SIGTERM' to process[sh-2]" in out
    assert process.returncode == 0


def test_sigkill_ends_what_ignores_everything(start):
    process = start(
        """
launch:
- executable:
    cmd: sh -c 'trap "" INT TERM; echo up $$; while :; do sleep 0.05; done'
    output: screen
    sigterm_timeout: 0.2
    sigkill_timeout: 0.2
"""
    )
    pid = int(read_until(process, "[sh-1] up")[-1].split()[-1])
    process.terminate()
    out, _ = process.communicate(timeout=20)
    assert "escalating to 'SIGKILL'" in out
    assert not lives(pid)


def test_respawn(start, tmp_path):
    process = start(
        f"""
launch:
- executable:
    cmd: sh -c 'echo run >> {tmp_path}/runs; exit 1'
    respawn: true
    respawn_delay: 0.05
    respawn_max_retries: 2
"""
    )
    out, _ = process.communicate(timeout=20)
    assert (tmp_path / "runs").read_text() == "run\n" * 3
    assert out.count("process started with pid") == 3
    assert process.returncode == 1


def test_on_exit_shutdown_ends_the_others(start):
    process = start(
        "launch:\n- executable: {cmd: sleep 60}\n"
        "- executable: {cmd: sleep 0.2, on_exit: shutdown}\n"
    )
    out, _ = process.communicate(timeout=20)
    assert "process [sleep-2] ended, shutting down" in out
    assert process.returncode == 0


def test_what_a_process_started_ends_with_it(start):
    process = start(
        """
launch:
- executable:
    cmd: sh -c 'sleep 77 & echo up $!; sleep 0.2'
    output: screen
- executable: {cmd: sleep 60}
"""
    )
    (pid,) = [int(line.split()[-1]) for line in read_until(process, "[sh-1] up") if "up" in line]
    wait_until(lambda: not lives(pid))
    assert process.poll() is None  # the other goes on
    process.terminate()
    process.communicate(timeout=20)


@pytest.mark.long
def test_nothing_outlives_a_launch_that_is_killed(start, tmp_path):
    """Neither a polite process, nor one that ignores SIGTERM, nor a grandchild."""
    process = start(
        f"""
launch:
- let: {{name: file, value: {tmp_path}/vented}}
- executable:
    cmd: >-
      sh -c 'trap "echo safe > $(var file); exit" TERM; echo up $$; while :; do sleep 0.05; done'
    output: screen
- executable:
    cmd: sh -c 'trap "" TERM; sleep 77 & echo up $$; echo up $!; wait; wait'
    output: screen
"""
    )
    lines = [line for _ in range(3) for line in read_until(process, "] up ")]
    pids = [int(line.split()[-1]) for line in lines if "] up " in line]
    assert len(pids) == 3 and all(lives(pid) for pid in pids)
    process.kill()
    wait_until(lambda: not any(lives(pid) for pid in pids))
    assert (tmp_path / "vented").read_text() == "safe\n"
