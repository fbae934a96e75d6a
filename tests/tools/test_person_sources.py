"""The table of sources has the numbers that persons are made of, and says how each was read."""

import dataclasses

import pytest

from assistax_envs.persons.rows import PARAMETERS, WIDTH
from assistax_envs.registered import OURS
from tools.person_sources import READ, find_problems, read, rows_of

OF_US = {task: PARAMETERS[task] for task in OURS}


def test_the_table_has_every_number_of_every_task() -> None:
    table = read()
    assert find_problems(OF_US, table) == []
    assert table == rows_of(OF_US, table)
    for task in OURS:
        assert sum(row["tasks"] == "all" or task in row["tasks"].split() for row in table) == WIDTH


@pytest.mark.parametrize("change", [{"high": 0.9}, {"source": "design: a guess"}, {"none": 0.1}])
def test_a_changed_number_is_noticed(change: dict[str, float | str]) -> None:
    numbers = PARAMETERS["gentle_lift"]
    other = dataclasses.replace(numbers[0], **change)
    problems = find_problems(OF_US | {"gentle_lift": (other, *numbers[1:])}, read())
    assert any("strength of gentle_lift: another" in problem for problem in problems)
    assert any("strength of all: no person has it" in problem for problem in problems)


def test_a_changed_table_is_noticed() -> None:
    table = read()
    [place] = [at for at, row in enumerate(table) if row["name"] == "fatigue"]
    table[place] = table[place] | {"high": "2"}
    assert find_problems(OF_US, table) == [
        "fatigue of all: another high than the tasks' numbers have"
    ]


@pytest.mark.parametrize("how", ["", "hearsay", "printed table"])
def test_a_figure_from_memory_is_not_called_read(how: str) -> None:
    table = read()
    [fatigue] = [row for row in table if row["name"] == "fatigue"]
    fatigue[READ[0]] = how
    assert find_problems(OF_US, table) == [f"fatigue of all: read as {how!r}; allowed is memory"]
