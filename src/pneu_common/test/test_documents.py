# SPDX-License-Identifier: Apache-2.0
"""Documents that people write: plain values, or one sentence on both sides of every limit."""

import math
import warnings
from pathlib import Path
from typing import Any

import pytest

from pneu_common import documents
from pneu_common.documents import check_values, parse_yaml, read_json, read_text, read_yaml
from pneu_common.errors import InputError

pytestmark = pytest.mark.kernel_free


def refusal(call: Any, *arguments: Any) -> str:
    with pytest.raises(InputError) as caught:
        call(*arguments)
    return str(caught.value)


def nested(levels: int, value: Any = 1) -> Any:
    for level in range(levels):
        value = [value] if level % 2 else {"a": value}
    return value


def test_a_text_as_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes("α: 1\r\nb\rc\n\r".encode())
    assert read_text(path, "rig file") == read_text(str(path), "rig file") == "α: 1\nb\nc\n\n"


def test_a_text_of_the_largest_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert documents.LARGEST_BYTES == 32 * 1024 * 1024
    monkeypatch.setattr(documents, "LARGEST_BYTES", 12)
    path = tmp_path / "a.yaml"
    path.write_text("x" * 12)
    assert read_text(path, "rig file") == "x" * 12
    path.write_text("x" * 13)
    said = f"{path}: has more than 12 bytes, too many for a rig file"
    assert refusal(read_text, path, "rig file") == said
    said = "/dev/zero: has more than 12 bytes, too many for a rig file"
    assert refusal(read_text, "/dev/zero", "rig file") == said


def test_a_text_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    assert refusal(read_text, path, "rig file") == f"{path}: no such rig file"
    path.write_bytes(b"abc\xff")
    said = f"{path}: cannot be read as a rig file (byte 3 is not UTF-8 text)"
    assert refusal(read_text, path, "rig file") == said
    said = f"{tmp_path}: cannot be read as a rig file (Is a directory)"
    assert refusal(read_text, tmp_path, "rig file") == said
    said = "a\0b: cannot be read as a rig file (embedded null byte)"
    assert refusal(read_text, "a\0b", "rig file") == said


def test_yaml_and_json_as_plain_values(tmp_path: Path) -> None:
    values = {"a": [1, 2.5, True, None], "b": {"c": "d"}}
    (tmp_path / "a.yaml").write_text("a: [1, 2.5, true, null]\nb:\n  c: d\n")
    (tmp_path / "a.json").write_text('{"a": [1, 2.5, true, null], "b": {"c": "d"}}')
    for found in (
        read_yaml(tmp_path / "a.yaml", "rig file"),
        read_json(tmp_path / "a.json", "result"),
        parse_yaml("a: [1, 2.5, true, null]\nb: {c: d}", "a", "rig file"),
    ):
        assert found == values
        assert [type(part) for part in (found, found["a"], found["b"])] == [dict, list, dict]
    for known in (
        read_yaml(str(tmp_path / "a.yaml"), "rig file", lines=True),
        parse_yaml("a: [1, 2.5, true, null]\nb:\n  c: d\n", "a", "rig file", lines=True),
    ):
        assert known == values
        assert (known.lc.value("b"), known["b"].lc.key("c")) == ((2, 2), (2, 2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: 1\nb: [1", "is not YAML, line 2: "),
        ("a: 1\na: 2", "is not YAML, line 2: found duplicate key"),
        ("a: \0", "is not YAML: "),
        ("[" * 600, "is nested too deeply for a rig file"),
        (f"a: {'9' * 5000}", "is no rig file in YAML (a number has thousands of digits, allowed"),
        ("a: 2020-99-99", "is no rig file in YAML (month must be in 1..12)"),
        ("{{a: b}: c}", "is not YAML, line 1: found unhashable key"),
        ("a: !!int ''", "is no rig file in YAML ("),
        ("a: !!bool maybe", "is no rig file in YAML ("),
        ('a: "\\UFFFFFFFF"', "is no rig file in YAML ("),
    ],
    ids=range(10),
)
def test_text_that_is_not_yaml(tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    said = refusal(read_yaml, tmp_path / "a.yaml", "rig file")
    assert said.startswith(f"{tmp_path / 'a.yaml'}: {expected}")
    assert refusal(parse_yaml, text, "the page", "rig file").startswith(f"the page: {expected}")


def test_a_tag_of_a_mapping_at_a_number() -> None:
    """Only where lines are kept, YAML of that kind is refused in another way."""
    said = refusal(parse_yaml, "a: !!omap 3", "the page", "rig file", True)
    assert said.startswith("the page: is no rig file in YAML (")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"a": 1,\n"b": }', "is not JSON, line 2: Expecting value"),
        ("[" * 100_000, "is nested too deeply for a result"),
        ("9" * 5000, "is no result in JSON (a number has thousands of digits, allowed are those up"
                     " to 1e308)"),
        ('{"b": ["\\ud800"]}', "b.0: found '\\ud800', which is half of a character"),
    ],
    ids=range(4),
)  # fmt: skip
def test_text_that_is_not_json(tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "a.json").write_text(text)
    assert refusal(read_json, tmp_path / "a.json", "result") == f"{tmp_path / 'a.json'}: {expected}"


def test_an_anchor_that_is_set_anew_is_allowed():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = "a: &x 1\nb: *x\nc: &x 2\nd: *x"
        assert parse_yaml(text, "a", "file") == {"a": 1, "b": 1, "c": 2, "d": 2}


LARGEST = 10**308


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ([0, LARGEST + 1], "1: found a whole number of 309 digits, allowed are numbers up to"
                           " 1e308"),
        ({"a": {"b": -(10**400)}}, "a.b: found a whole number of 401 digits, allowed are numbers"
                                   " up to 1e308"),
        (10**5000, "found a whole number of 5001 digits, allowed are numbers up to 1e308"),
        ({"a": [0, "b\ud800"]}, "a.1: found '\\ud800', which is half of a character"),
        ({"a": {"b\udfff": 1}}, "a: found '\\udfff', which is half of a character"),
        ({"\ud800": 1}, "found '\\ud800', which is half of a character"),
        ("\ud800", "found '\\ud800', which is half of a character"),
        (nested(101), "is nested too deeply, allowed are 100 levels"),
    ],
    ids=range(8),
)  # fmt: skip
def test_values_that_nobody_can_compute_with(data: Any, expected: str) -> None:
    assert refusal(check_values, data, "a.yaml") == f"a.yaml: {expected}"


@pytest.mark.parametrize(
    "data",
    [
        [LARGEST, -LARGEST, True, None, math.inf, ""],
        {1: "a", "b": {}, None: []},
        nested(100),
        nested(100, "text"),
        [nested(99), nested(99)],
        "text",
        7,
        None,
    ],
)
def test_values_within_the_limits(data: Any) -> None:
    check_values(data, "a.yaml")


@pytest.mark.parametrize("leaf", ["1", "text"])
def test_levels_that_aliases_hide(leaf: str) -> None:
    """Each part nests the one before, so that no line of the text is deep."""
    parts = [f"- &a0 [{leaf}]", *(f"- &a{k} [*a{k - 1}]" for k in range(1, 99))]
    assert len(parse_yaml("\n".join(parts), "a.yaml", "file")) == 99
    parts.append("- [*a98]")
    said = "a.yaml: is nested too deeply, allowed are 100 levels"
    assert refusal(parse_yaml, "\n".join(parts), "a.yaml", "file") == said


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("[a, b, 3, 4, 5, 6, 7, 8, 9, 10, 11{}]", "11"),
        ("b: 1\na: [1, 2, 3, 4, 5, 6, 7, 8, 9{}]", "a"),
        ("[0, {{b: [1, 2, 3, 4, 5, 6, 7, 8{}]}}]", "1"),
        ("a: &x [1, 2, 3]\nb: {{c: *x, d: [1{}]}}", "b"),
        ("- &x {{a: 1, b: 2}}\n- [*x, *x]\n- [{}]", "2"),
    ],
)
def test_as_many_values_as_are_read(text: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A list is a value besides those in it, and an alias counts as often as it stands there."""
    assert documents.MOST_VALUES == 1_000_000
    monkeypatch.setattr(documents, "MOST_VALUES", 12)
    parse_yaml(text.format(""), "a.yaml", "file")
    more = ", 0" if "[{}" not in text else "0"
    expected = "stands for more than 12 values, which is the most that are read"
    assert (
        refusal(parse_yaml, text.format(more), "a.yaml", "file") == f"a.yaml: {where}: {expected}"
    )


def test_aliases_that_stand_for_too_much_or_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(documents, "MOST_VALUES", 12)
    expected = "stands for more than 12 values, which is the most that are read"
    text = "a: &x [1, 2, 3]\nb: [0, {c: [*x, *x, *x]}]"
    assert refusal(parse_yaml, text, "a.yaml", "file") == f"a.yaml: b.1.c: {expected}"
    expected = "an alias stands for a part that contains it"
    for text, where in (
        ("&m [1, *m]", "1"),
        ("a: 1\nb: &m {c: [0, 0, *m]}", "b.c.2"),
        ("- 0\n- &m [[*m]]", "1.0.0"),
    ):
        assert refusal(parse_yaml, text, "a.yaml", "file") == f"a.yaml: {where}: {expected}"


@pytest.mark.parametrize("lines", [False, True])
def test_merges_that_would_be_copied_for_ever(lines: bool) -> None:
    """A million entries and no more; of each level ten times those of the one before."""
    first = "a0: &a0 {" + ", ".join(f"k{k}: 1" for k in range(10)) + "}"

    def text(levels: int, more: str = "") -> str:
        rows = [
            f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 10)}]{more if n == levels else ''}}}"
            for n in range(1, levels + 1)
        ]
        return "\n".join([first, *rows])

    read = parse_yaml(text(3), "a.yaml", "file", lines)
    assert len(read["a3"]) == 10
    said = "merges more than 1000000 entries, which is the most that are read"
    assert refusal(parse_yaml, text(6), "a.yaml", "file", lines) == f"a.yaml, line 7: {said}"
    told = refusal(parse_yaml, text(5, ", b: 1"), "a.yaml", "file", lines)
    assert told == f"a.yaml, line 6: {said}"
    nested = [
        "s0: &s0 [&m {a: 1}]",
        *(f"s{n}: &s{n} [{', '.join([f'*s{n - 1}'] * 10)}]" for n in range(1, 30)),
    ]
    for odd in ("a: &a {<<: *a}", "a: &a {<<: [*a]}", "\n".join([*nested, "x: {<<: *s29}"])):
        assert refusal(parse_yaml, odd, "a.yaml", "file", lines).startswith("a.yaml")
