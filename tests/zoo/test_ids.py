import dataclasses
from contextlib import nullcontext

import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from assistax_base.errors import IdError, ZooError
from zoo.ids import TeamId, check_name, parse_team
from zoo.schema import Ego

NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,31}", fullmatch=True)
TEAMS = st.builds(
    TeamId,
    task=NAMES,
    algorithm=NAMES,
    disability=st.integers(1, 9999).map(lambda n: f"d{n}") | st.just("ego"),
    namespace=st.just("") | NAMES,
    seed=st.integers(0, 2**63 - 1),
    release=st.integers(0, 10**10 - 1).map(lambda n: f"v{n}"),
)


@seed(0)
@settings(deadline=None)
@given(TEAMS, TEAMS)
def test_parse_and_format_are_inverse(first: TeamId, other: TeamId) -> None:
    assert parse_team(str(first)) == first
    assert (str(first) == str(other)) == (first == other)


@seed(2)
@settings(deadline=None)
@given(
    st.text(max_size=40)
    | st.from_regex(
        r"([a-z]+:)?[a-z]+/[a-z]+-(d[0-9]+|ego)-s[0-9]+-v[0-9]+(/[a-z]+)?", fullmatch=True
    )
)
def test_any_text_formats_back_or_is_refused(text: str) -> None:
    try:
        assert str(parse_team(text)) == text
    except IdError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    "text",
    [
        "scratch/ippo-d3-s5",
        "scratch/ippo-d3-s05-v1",
        "scratch/ippo-d0-s5-v1",
        "Scratch/ippo-d3-s5-v1",
        "scratch/ippo-d3-s5-v1/",
        "scratch/ippo-d3-s5-v1\n",
        "scratch/ippo-d3-s٣-v1",
        "../ippo-d3-s5-v1",
        "scratch//ippo-d3-s5-v1",
        "",
        ":scratch/ippo-d3-s5-v1",
        "a:b:scratch/ippo-d3-s5-v1",
        "Lab:scratch/ippo-d3-s5-v1",
    ],
)
def test_bad_team_ids_are_refused(text: str) -> None:
    with pytest.raises(IdError, match="task/algorithm-dN-sM-vR"):
        parse_team(text)


@pytest.mark.parametrize(
    "field",
    [{"task": "bed-bath"}, {"disability": "3"}, {"seed": -1}, {"seed": True}, {"release": "1"}],
)
def test_unparsable_team_id_cannot_be_built(field: dict) -> None:
    with pytest.raises(IdError):
        dataclasses.replace(parse_team("scratch/ippo-d3-s5-v1"), **field)


def test_egos_are_robots_alone() -> None:
    ego = parse_team("lab:scratch/ppo-ego-s0-v1")
    assert ego.is_ego and (ego.namespace, ego.seed) == ("lab", 0)
    assert not parse_team("scratch/ppo-d1-s0-v1").is_ego
    row = {"shard": "zoo/shards/v1/a.safetensors", "row": 0, "sha256": "0" * 64}
    against = {"split": "scratch/half-s0-v1-0", "sha256": "0" * 64}
    for role, allowed in (("robot", True), ("human", False)):
        with nullcontext() if allowed else pytest.raises(ValidationError, match="robot"):
            Ego.model_validate({"run": "r", "trained_against": against, "policies": {role: row}})


def test_order_counts_numbers() -> None:
    ids = [f"scratch/ippo-d{d}-s{s}-v1" for d in (10, 2) for s in (10, 9)]
    ordered = sorted(map(parse_team, ids), key=lambda team: team.order)
    expected = [("d2", 9), ("d2", 10), ("d10", 9), ("d10", 10)]
    assert [(team.disability, team.seed) for team in ordered] == expected


def test_release_names() -> None:
    assert check_name("release", "v10") == "v10"
    for text in ("1", "v01", "V1", "v1/..", ""):
        with pytest.raises(IdError, match="release"):
            check_name("release", text)


def test_control_characters_do_not_break_the_line() -> None:
    message = str(ZooError("a\nb", expected="\x1b[31m", found="c", done="d", next_step="e"))
    assert message.isprintable()
