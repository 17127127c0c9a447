# SPDX-License-Identifier: Apache-2.0
"""What pydantic finds wrong is told in one sentence, and settings refuse what they cannot be."""

from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from pneu_common.errors import InputError
from pneu_common.validation import Listed, Settings, sentence


class Port(BaseModel):
    model_config = ConfigDict(extra="forbid")
    area_m2: Annotated[float, Field(gt=0.0)]
    to: Annotated[str, Field(alias="to_node")]


class Reading(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["read"]
    address: int = 0


class Writing(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["write"]
    address: int = 0
    safe: float = 0.0


class House(BaseModel):
    model_config = ConfigDict(extra="forbid")
    ports: dict[str, Port] = Field(default_factory=dict)
    rows: list[Port | None] = Field(default_factory=list)
    channel: Annotated[Reading | Writing, Field(discriminator="kind")] | None = None


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({"port": {}}, "unknown key 'port'; did you mean 'ports'?"),
        ({"colour": 1}, "unknown key 'colour'; known are ports, rows, channel"),
        (
            {"ports": {"in": {"area": 1.0, "to_node": "a"}}},
            "unknown key 'ports.in.area'; did you mean 'area_m2'?",
        ),
        (
            {"ports": {"in": {"area_m2": -1.0, "to_node": "a"}}},
            "ports.in.area_m2: Input should be greater than 0, found -1.0",
        ),
        (
            {"rows": [{"area_m2": 1.0, "to_nod": "a", "to_node": "a"}]},
            "unknown key 'rows.0.to_nod'; did you mean 'to_node'?",
        ),
        (
            {"channel": {"kind": "write", "adress": 2}},
            "unknown key 'channel.adress'; did you mean 'address'?",
        ),
        (
            {"channel": {"kind": "write", "safe": "low"}},
            "channel.safe: Input should be a valid number, unable to parse string as a number,"
            " found 'low'",
        ),
        ({"ports": {"in": {"to_node": "a"}}}, "ports.in.area_m2: Field required"),
        ({"channel": {"address": 2}}, "channel: kind is needed, which says what kind it is"),
        (
            {"channel": {"kind": "wrote"}},
            "channel: kind: found 'wrote', allowed are 'read', 'write'",
        ),
    ],
)
def test_one_sentence_says_where_and_what(data, told):
    with pytest.raises(ValidationError) as caught:
        House.model_validate(data)
    assert sentence(caught.value, House) == told


class Inner(Settings):
    share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5


class Outer(Settings):
    count: int = 3
    times: Annotated[tuple[float, ...], Listed] = (1.0,)
    inner: Inner = Inner()
    name: str | None = None


def test_settings_are_checked_as_they_are_made():
    assert Outer(times=[1, 2.5], inner={"share": 1}) == Outer(
        times=(1.0, 2.5), inner=Inner(share=1.0)
    )
    for values, told in (
        ({"count": 2.0}, "count: Input should be a valid integer, found 2.0"),
        ({"count": "2"}, "count: Input should be a valid integer, found '2'"),
        ({"times": [float("nan")]}, r"times\.0: Input should be a finite number, found nan"),
        ({"inner": {"share": 2.0}}, r"inner\.share: Input should be less than or equal to 1"),
        ({"inner": {"shares": 1.0}}, r"unknown key 'inner\.shares'; did you mean 'share'\?"),
        ({"nmae": "a"}, "unknown key 'nmae'; did you mean 'name'"),
    ):
        with pytest.raises(InputError, match=told) as caught:
            Outer(**values)
        assert "\n" not in str(caught.value)


def test_settings_do_not_change_but_make_others():
    one = Outer(count=5)
    with pytest.raises(ValidationError):
        one.count = 6
    other = one.but(name="b")
    assert (other.count, other.name, one.name) == (5, "b", None)
    with pytest.raises(InputError, match="count"):
        one.but(count=None)
    assert Outer(**one.plain()) == one and one.plain()["times"] == [1.0]
    assert Outer.usual("count") == 3
