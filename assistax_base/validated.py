"""Dataclasses whose values pydantic checks against their annotations, with errors of one line."""

import dataclasses
import functools
from typing import Annotated, Any, TypeVar, dataclass_transform

import pydantic
from pydantic import ConfigDict, Field, ValidationError

from assistax_base.errors import shorten

C = TypeVar("C")
T = TypeVar("T")

Many = Annotated[tuple[T, ...], Field(strict=False)]  # of a JSON file it is a list
Widths = Annotated[Many[pydantic.PositiveInt], Field(min_length=1)]  # of hidden layers
Share = Annotated[float, Field(ge=0, le=1)]


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def validated(cls: type[C]) -> type[C]:
    """Make a class a frozen dataclass that refuses values of other types with a ValueError.

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
    """Return one line: the refused value, the allowed values, and the count of further problems."""
    problems = error.errors(include_url=False)
    problem, more = problems[0], len(problems) - 1
    where = ".".join(map(str, problem["loc"]))[:200]
    match problem["type"]:
        case "value_error":  # said by the class itself, which names its field
            text = f"{where}: {problem['ctx']['error']}".removeprefix(": ")
        case "json_invalid":
            text = f"it is not JSON ({problem['ctx']['error']})"
        case "unexpected_keyword_argument" | "extra_forbidden":
            text = f"unknown field {where}"
        case "missing":
            text = f"{where} is missing"
        case _:
            allowed = problem["msg"].replace("Input should", "it must")
            text = f"{where} is {shorten(problem['input'])}; {allowed}"
    return f"{text}, and {more} more problem{'s' if more > 1 else ''}" if more else text
