"""Dataclasses whose values pydantic checks against their annotations, with errors of one line."""

import dataclasses
import functools
import reprlib
from typing import Annotated, Any, TypeVar, dataclass_transform

import pydantic
from pydantic import ConfigDict, Field, ValidationError

C = TypeVar("C")
T = TypeVar("T")

Many = Annotated[tuple[T, ...], Field(strict=False)]  # of a JSON file it is a list
Widths = Annotated[Many[pydantic.PositiveInt], Field(min_length=1)]  # of hidden layers
Share = Annotated[float, Field(ge=0, le=1)]


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def checked(cls: type[C]) -> type[C]:
    """Make a class a frozen dataclass; creating it with other values raises a ValueError.

    Numbers are finite, and a text is not taken for a number, nor true for 1.
    """
    config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    made: Any = pydantic.dataclasses.dataclass(frozen=True, config=config)(cls)
    create, names = made.__init__, [field.name for field in dataclasses.fields(made)]

    @functools.wraps(create)
    def one_line(self: C, *args: Any, **kwargs: Any) -> None:
        try:  # by name, so that errors have names
            create(self, **dict(zip(names, args, strict=False)), **kwargs)
        except ValidationError as error:
            raise ValueError(first_problem(error)) from None

    made.__init__ = one_line
    return made


def first_problem(error: ValidationError) -> str:
    """Say in one line which value is refused, and what is allowed."""
    problem = error.errors(include_url=False)[0]
    where = ".".join(map(str, problem["loc"]))
    if problem["type"] == "value_error":  # said by the class itself, which names its field
        return f"{where}: {problem['ctx']['error']}".removeprefix(": ")
    if problem["type"] == "json_invalid":
        return f"it is not JSON ({problem['ctx']['error']})"
    if problem["type"] == "unexpected_keyword_argument":
        return f"unknown field {where}"
    if problem["type"] == "missing":
        return f"{where} is missing"
    allowed = problem["msg"].replace("Input should", "it must")
    return f"{where} is {reprlib.repr(problem['input'])}; {allowed}"
