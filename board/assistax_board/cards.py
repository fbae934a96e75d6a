"""The card of a declared entry: its training, in the words of its lab."""

import dataclasses
import re

from assistax_board.problems import Problem

WORDS = 200  # characters of a text of the card
LINK = re.compile(r"https?://[^\s/]+(/\S*)?")  # that pages may lead to
_STEPS, _TRAINED = 10**15, 10**6  # most that a card may say


@dataclasses.dataclass(frozen=True)
class Card:
    """A lab's word on an entry: not all of it can be checked, so it is shown as the lab's."""

    steps: int  # of the environment, in each seed's training
    partners: str  # met in training
    code: str  # where it is, or "not published"
    trained: int  # seeds that were trained so, those that are not handed in too


def check_card(card: Card, seeds: int) -> None:
    """Check a card of an entry with so many seeds.

    Raises:
        Problem: A number or a text is not of the form.
    """
    if not 1 <= card.steps <= _STEPS:
        raise Problem("invalid", f"steps is {card.steps}; give the steps of one seed's training")
    if not seeds <= card.trained <= _TRAINED:
        raise Problem(
            "invalid",
            f"trained is {card.trained} and there are {seeds} files; count all seeds that you "
            "trained so, also those that you leave out",
        )
    for name, text in (("partners", card.partners), ("code", card.code)):
        if not 1 <= len(text) <= WORDS or not text.isprintable():
            raise Problem("invalid", f"{name} has 1 to {WORDS} printable characters")
