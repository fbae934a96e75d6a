"""Parts of a row's seeds, which may be trained on different cards or machines."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.bounded_reading import parse_json
from assistax_base.errors import listing
from assistax_base.files import write_json
from evaluation.record import tables
from evaluation.validation import CHOICES, CURVE, Choice, Choices, best_of_each
from population.runs.folder import RunFolder
from tools.league.rows import Row

TRAINED, RECORD = "training", "row.json"  # the folder of a row's training, and a record


@dataclasses.dataclass(frozen=True)
class Part:
    """Part of a row's seeds that is trained separately, or all parts joined."""

    number: int | None  # from 1; None for all of them
    count: int

    @classmethod
    def parse(cls, text: str) -> "Part":
        """Return the part of a text such as "2/4" or "all/4".

        Raises:
            ValueError: The text is not of that form.
        """
        number, _, count = text.partition("/")
        if count.isdecimal() and (number == "all" or number.isdecimal()):
            part = cls(None if number == "all" else int(number), int(count))
            if part.count and (part.number is None or 1 <= part.number <= part.count):
                return part
        raise ValueError(
            f"part is {text!r}; give its number and of how many, such as 2/4, or all/4 to put "
            "four parts together"
        )

    @property
    def joins(self) -> bool:
        """Whether it is all parts joined."""
        return self.number is None

    @property
    def name(self) -> str:
        """Name of its folder."""
        return TRAINED if self.number is None else f"part-{self.number}-of-{self.count}"

    def seeds(self, of: Sequence[int]) -> tuple[int, ...]:
        """Return the part's seeds: equally many for each part, and the rest for the last."""
        if self.number is None:
            return tuple(of)
        size = -(-len(of) // self.count)
        return tuple(of[(self.number - 1) * size : self.number * size])

    def join(
        self, folder: Path, split: str, seeds: Sequence[int], best_of: int
    ) -> tuple[Choices, list[dict[str, Any]]]:
        """Write the joined choices of all parts beside them; return these and the parts' records.

        Args:
            folder: Has the parts.
            split: The league's split, which each part must have.
            seeds: Seeds of all parts together, in this order.
            best_of: Seeds of a group; the best seed of each group is chosen too.

        Raises:
            ValueError: The parts have other seeds, or another training or choice; or the folder
                has a training of all seeds at once.
            FileNotFoundError: A part is not finished. The error names it.
        """
        whole_run = RunFolder(folder / TRAINED)
        if whole_run.checkpoints.exists() or whole_run.teams.exists():
            raise ValueError(
                f"{folder / TRAINED} is a training of all seeds at once; parts would replace "
                "it: make and join the parts in another --out"
            )
        places = [folder / Part(number, self.count).name for number in range(1, self.count + 1)]
        if late := [place.name for place in places if not (place / RECORD).is_file()]:
            raise FileNotFoundError(f"{folder} lacks {', '.join(late)}; make them with --part")
        records, chosen = (
            [parse_json((place / name).read_text(encoding="utf-8")) for place in places]
            for name in (RECORD, CHOICES)
        )
        made = {
            (record["row"], record["split"], record["steps"], each["partners"], each["episodes"])
            for record, each in zip(records, chosen, strict=True)
        }
        if len({RunFolder(place).recipe for place in places}) > 1:
            raise ValueError(
                f"parts in {folder} were trained otherwise: their config.json differ in more than "
                "the seeds, such as partners' parameters; make them again alike"
            )
        found = [seed for record in records for seed in record["seeds"]]
        if found != list(seeds) or len(made) > 1 or records[0]["split"] != split:
            raise ValueError(
                f"parts in {folder} are of seeds {listing(map(str, found))}, by row, split, steps, "
                f"validators and episodes {sorted(made)}; wanted are seeds "
                f"{listing(map(str, seeds))} of {split}, all made alike"
            )
        by_seed = tuple(
            dataclasses.replace(Choice(**choice), file=f"../{place.name}/{choice['file']}")
            for place, each in zip(places, chosen, strict=True)
            for choice in each["by_seed"]
        )
        best = best_of_each(by_seed, best_of)
        asked = (chosen[0][name] for name in ("split", "partners", "episodes"))
        whole = Choices(*asked, by_seed, best_of, best)
        (folder / TRAINED).mkdir(exist_ok=True)
        curves = [tables.read_parquet(place / CURVE) for place in places]
        tables.write_parquet(pl.concat(curves), folder / TRAINED / CURVE)
        write_json(folder / TRAINED / CHOICES, dataclasses.asdict(whole))
        return whole, records


def picked(row: Row, chosen: Choices) -> tuple[Choice, ...]:
    """Return which of the chosen robots a row plays.

    Raises:
        ValueError: There are too few seeds for a group.
    """
    picked = chosen.best if row.source == "best-of" else chosen.by_seed
    if not picked:
        raise ValueError(
            f"seeds are {len(chosen.by_seed)}, and the best of each {chosen.best_of} is wanted; "
            "give that many or more"
        )
    return picked


def teachers(folder: Path, row: Row) -> list[Path]:
    """Return the policy files of the best quarter of the row that another imitates, by validation.

    Args:
        folder: Folder of the teachers' row, with its training.
        row: The row that imitates them.

    Raises:
        ValueError: The teachers are not trained and chosen yet.
    """
    run = folder / TRAINED
    if not (run / CHOICES).is_file():
        raise ValueError(
            f"row {row.name} imitates robots of {row.teacher}, and {run} has none; make that row "
            "first"
        )
    chosen = parse_json((run / CHOICES).read_text(encoding="utf-8"))["by_seed"]
    best = sorted(chosen, key=lambda choice: -choice["mean"])[: -(-len(chosen) // 4)]
    return [run / choice["file"] for choice in best]
