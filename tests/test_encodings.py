# SPDX-License-Identifier: Apache-2.0
"""Names that the encoding of the output lacks, or that are no text at all, stop no command."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.domains import own_domain_id

from pneu_common.entry import COMMAND

ROOT = Path(__file__).parent.parent
ENCODINGS = {
    "utf-8": {"PYTHONIOENCODING": "utf-8"},
    "ascii": {"PYTHONIOENCODING": "ascii"},
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
}
LAUNCH = """launch:
- executable:
    cmd: "python3 -c 'import sys; sys.stdout.buffer.write(bytes([99, 97, 102, 255, 10]))'"
    name: "caf\u00e9"
    output: screen
- log: {message: "caf\u00e9"}
"""


@pytest.fixture(
    params=["C", *(pytest.param(name, marks=pytest.mark.long) for name in ("utf-8", "ascii"))]
)
def surroundings(request, tmp_path):
    """A folder with files whose names are no text, and the environment of a command."""
    folder = os.fsencode(tmp_path)
    shutil.copyfile(ROOT / "rigs" / "rig_a_fitted.yaml", folder + b"/rig\xff.yaml")
    shutil.copytree(os.fsencode(ROOT / "data" / "bags" / "a_leak"), folder + b"/bag\xff")
    Path(os.fsdecode(folder + b"/own\xff.launch.yaml")).write_text(LAUNCH, encoding="utf-8")
    logs = {"ROS_LOG_DIR": os.fsdecode(folder + b"/log\xff"), "ROS_DOMAIN_ID": str(own_domain_id())}
    return tmp_path, {**os.environ, **ENCODINGS[request.param], **logs}


def run(surroundings, *words):
    """Returns status, output and errors of the `pneu` command."""
    folder, environment = surroundings
    done = subprocess.run([*COMMAND, *words], cwd=folder, env=environment, capture_output=True)
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (["check", b"rig\xff.yaml"], 0),
        (["check", b"missing\xff.yaml"], 2),
        (["init", b"made\xff", "--kind", "tee"], 0),
        (["bag", "info", b"bag\xff"], 0),
        (["bag", "record", "-a", "-o", b"made\xff"], 2),
        (["bag", "record", "-a", "-o", "made", "--attach", b"rig\xff.yaml"], 2),
        (["launch", "--print", b"own\xff.launch.yaml"], 0),
        (["launch", b"own\xff.launch.yaml"], 0),
    ],
    ids=lambda given: "-".join(map(str, given[:2])) if isinstance(given, list) else "",
)
def test_a_name_that_is_no_text_is_shown(surroundings, words, status):
    found, _, errors = run(surroundings, *words)
    assert found == status, errors
    assert "Traceback" not in errors and "error inside" not in errors


def test_a_recording_gets_no_name_that_is_no_text(surroundings):
    """Its metadata, which is YAML, names its files."""
    words = ["simulate", "--rig", b"rig\xff.yaml", "--steps", "voltage=5:0.1", "-o"]
    status, _, errors = run(surroundings, *words, b"simulated\xff")
    said = errors.splitlines()[-1]  # one before may say that kernels are compiled
    assert status == 2 and "Traceback" not in errors
    assert "simulated" in said and "metadata.yaml" in said
    assert not os.path.exists(os.fsencode(surroundings[0]) + b"/simulated\xff")
    status, _, errors = run(surroundings, *words, "simulated")
    assert (status, errors) == (0, "")


@pytest.mark.long
def test_results_of_names_that_are_no_text_are_utf_8(surroundings):
    words = ["compare", b"bag\xff", "--rig", b"rig\xff.yaml", "--no-refine"]
    words += ["--json", b"result\xff.json", "--report", b"report\xff.html"]
    status, output, errors = run(surroundings, *words)
    assert status == 0 and "RMSE" in output, errors
    folder = os.fsencode(surroundings[0])
    with open(folder + b"/result\xff.json", encoding="utf-8") as result:
        assert "bag" in json.dumps(json.load(result))
    with open(folder + b"/report\xff.html", encoding="utf-8") as report:
        assert "<h1>bag&#56575;</h1>" in report.read()  # U+DCFF, which stands for the byte


LOGGING = """
import sys
from pneu_runtime import hook
hook.install()
import rclpy
from rcl_interfaces.msg import Log
rclpy.init(args=[])
node = rclpy.create_node("caller")
heard = []
node.create_subscription(Log, "/rosout", heard.append, 10)
node.get_logger().error("caf\\u00e9 \\udcff")
while not heard:
    rclpy.spin_once(node, timeout_sec=0.1)
assert heard[0].msg == "caf\\u00e9 \\\\udcff", heard[0].msg
"""


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_log_line_that_is_no_text_is_printed_and_published(surroundings, stream):
    folder, environment = surroundings
    environment = {**environment, "RCUTILS_LOGGING_USE_STDOUT": str(int(stream == "stdout"))}
    done = subprocess.run(
        [sys.executable, "-c", LOGGING], cwd=folder, env=environment, capture_output=True
    )
    assert done.returncode == 0, done.stderr
    assert b"[caller]: caf" in getattr(done, stream) and b" \\udcff" in getattr(done, stream)
