"""Parts of a row's seeds, which may be trained on other cards or machines."""

import dataclasses
from collections.abc import Sequence

TRAINED = "training"  # the folder of a row's training as a whole


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a row's seeds that is trained apart, or all parts put together."""

    number: int | None  # from 1; None for all of them
    count: int

    @classmethod
    def parse(cls, text: str) -> "Part":
        """Return the part that a text such as "2/4" or "all/4" means.

        Raises:
            ValueError: It means none.
        """
        number, _, count = text.partition("/")
        if count.isdecimal() and (number == "all" or number.isdecimal()):
            part = cls(None if number == "all" else int(number), int(count))
            if part.number is None or 1 <= part.number <= part.count:
                return part
        raise ValueError(
            f"part is {text!r}; give its number and of how many, such as 2/4, or all/4 to put "
            "four parts together"
        )

    @property
    def each(self) -> tuple["Part", ...]:
        """All parts that it is one of, or that it puts together."""
        return tuple(Part(number, self.count) for number in range(1, self.count + 1))

    @property
    def name(self) -> str:
        """Its folder beside those of the other parts."""
        return TRAINED if self.number is None else f"part-{self.number}-of-{self.count}"

    def seeds(self, of: Sequence[int]) -> tuple[int, ...]:
        """Return its seeds; equal counts for all parts, and the last has what is left."""
        if self.number is None:
            return tuple(of)
        size = -(-len(of) // self.count)
        return tuple(of[(self.number - 1) * size : self.number * size])
