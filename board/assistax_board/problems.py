"""Errors of a request: a code, and a message that names the next step."""

import dataclasses

from assistax_board.vocabulary import REFUSALS


@dataclasses.dataclass
class Problem(ValueError):
    """A request that is not granted; nothing was changed."""

    code: str  # for programs: one of `CODES`
    message: str  # for people: what was found, what is allowed, what to do next
    retry_after: int | None = None  # seconds, where asking again will help
    remedy: str = ""  # for a command line, which names its option: see `ZooError`

    def __str__(self) -> str:
        return self.message


# The code and its HTTP status.
CODES = {
    "not_signed_in": 401,
    "not_allowed": 403,
    "not_found": 404,
    "too_late": 409,
    "conflict": 409,
    "lease_lost": 409,
    "too_large": 413,
    "invalid": 422,
    "budget_spent": 429,
    "too_many_requests": 429,
    "unavailable": 503,
    "too_full": 507,
}


class Refusal(ValueError):
    """A robot that cannot be scored; `code` is a word of `vocabulary.REFUSALS`.

    `detail` is for the submitter's own eyes, at home; the server keeps and shows the code alone.
    """

    def __init__(self, code: str, detail: str = "") -> None:
        self.code, self.detail = code, detail
        super().__init__(f"{REFUSALS[code]}{f' ({detail})' if detail else ''}")
