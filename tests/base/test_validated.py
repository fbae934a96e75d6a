"""One line says which value was refused, whichever model refused it."""

import pytest
from pydantic import BaseModel, ConfigDict, PositiveInt, ValidationError

from assistax_base.validated import first_problem


class Entry(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    rows: PositiveInt
    name: str


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"rows": 1, "name": "a", "mood": 1}', "unknown field mood"),
        ('{"rows": 1}', "name is missing"),
        ('{"rows": 0, "name": "a"}', "rows is 0; it must be greater than 0"),
        ('{"rows": "0", "name": 1}', "rows is '0'; it must be a valid integer, and 1 more problem"),
        ('{"mood": 1}', "rows is missing, and 2 more problems"),
        ("{", "it is not JSON (EOF while parsing an object at line 1 column 1)"),
    ],
)
def test_the_first_problem_is_one_line(text: str, expected: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Entry.model_validate_json(text)
    assert first_problem(caught.value) == expected


def test_a_hostile_value_is_cut() -> None:
    with pytest.raises(ValidationError) as caught:
        Entry.model_validate({"rows": [["x" * 10_000] * 100] * 100, "y" * 10_000: 1, "name": "a"})
    assert len(first_problem(caught.value)) < 300
