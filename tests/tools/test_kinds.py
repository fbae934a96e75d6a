"""Code that asks for a kind of task or partner is found, with its line and a reason."""

import ast

import pytest

from tools import house, kinds

PLACE = "evaluation/play/planted.py"


def asked(text: str, place: str = PLACE) -> list[tuple[int, str]]:
    return list(kinds.questions(ast.parse(text), place))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('if task == "scratch": ...', "names the task scratch"),
        ('names = {"gentle_lift": 3}', "names the task gentle_lift"),
        ('name = f"gentle_bath/{number}"', "names the task gentle_bath"),
        ('glob = "scratch/ippo-*"', "names the task scratch"),
        ("from zoo.splits import PERSONS", "refers to PERSONS"),
        ("if split.rule == splits.PERSONS: ...", "refers to PERSONS"),
        ("row = parse_person(name)", "refers to parse_person"),
        ("def names_persons(globs): ...", "refers to names_persons"),
        ("if ids.asks_for_persons(split): ...", "refers to asks_for_persons"),
        ("from assistax_envs.versions import GENTLE_TASKS", "refers to GENTLE_TASKS"),
        ("if task in CARE_TASKS: ...", "refers to CARE_TASKS"),
        ('engine["condition"] = "told"', 'names the condition "told"'),
        ('condition != "told-partner"', 'names the condition "told-partner"'),
        ("if name == TOLD_PARTNER: ...", "refers to TOLD_PARTNER"),
        ('if hasattr(stack.spec, "humans"): ...', "asks hasattr(stack.spec, 'humans')"),
        ("if env.version == 2: ...", "compares a version: env.version == 2"),
        ("if 1 < split.env_version: ...", "compares a version: 1 < split.env_version"),
        ('job["env_version"] in (1, 2)', "compares a version: job['env_version'] in (1, 2)"),
    ],
)
def test_question_for_a_kind_is_found(text: str, reason: str) -> None:
    assert asked(f"x = 1\n{text}\n") == [(2, reason)]


@pytest.mark.parametrize(
    "text",
    [
        '"""A module about gentle_lift and scratch."""',
        'class Job:\n    task: str\n    """Such as "scratch"."""',
        'text = "training from scratch"',
        'text = "robots that are told the preference"',
        'if content["version"] != 2: ...',
        "if lock.version < 3: ...",
        "if env.version != split.env_version: ...",
        'if hasattr(robot, "act"): ...',
    ],
)
def test_other_code_asks_for_no_kind(text: str) -> None:
    assert asked(text) == []


@pytest.mark.parametrize(
    "place",
    [
        "assistax_envs/tasks/gentle_lift.py",
        "assistax_envs/tasks/gentle_lift/script.py",
        "assistax_envs/persons/rows.py",
        "assistax_envs/registered.py",
        "assistax_zoo/commands/evaluation/render.py",
        "zoo/partners/persons.py",
    ],
)
def test_home_of_a_kind_may_ask(place: str) -> None:
    assert asked('"gentle_lift", PERSONS', place) == []


def test_shared_base_of_tasks_may_not_ask() -> None:
    assert asked("version = 3\nversion > 2", "assistax_envs/tasks/gentle_base.py") == [
        (2, "compares a version: version > 2")
    ]


def test_only_the_views_name_their_conditions() -> None:
    assert asked('TOLD = "told"', "population/views.py") == []
    assert asked('TOLD = "told"', "population/config.py") == [
        (1, 'names the condition "told"'),
        (1, "refers to TOLD"),
    ]


def test_places_are_printed_with_file_and_line() -> None:
    text = 'TASK = "gentle_lift"\n'
    path = house.ROOT / "workshop/assistax_workshop/gates/planted.py"
    module = house.Module("assistax_workshop.gates.planted", path, text, ast.parse(text))
    assert list(house.kind_questions({module.name: module})) == [
        "workshop/assistax_workshop/gates/planted.py:1: names the task gentle_lift"
    ]
