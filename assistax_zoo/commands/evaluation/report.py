"""What finished folders show: differences of methods, strategies of partners, and a page."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_base.errors import printable
from assistax_zoo.shell.console import answer, new_table, print_json, print_table

if TYPE_CHECKING:
    from evaluation.figures.metrics import Difference


def compare(a: Path, b: Path, /, *, seed: int = 0, json: bool = False) -> None:
    """Compare method A with method B: paired differences A - B over the same partners and episodes.

    Args:
        a: Folder that `assistax-zoo evaluate --out` filled.
        b: Another, of the same task, split, episodes and seed.
        seed: Seed of the bootstrap.
        json: Print JSON.

    Example:
        assistax-zoo compare results/mine results/baseline
    """
    from assistax_zoo.results import compare as compare_results

    comparison = compare_results(a, b, seed=seed)
    sides = (("train", comparison.train), ("test", comparison.test))
    answer(
        json,
        {"a": str(a), "b": str(b), **comparison.to_json()},
        f"{comparison.task}: return of {a} minus return of {b}",
        *(_difference_line(side, difference) for side, difference in sides if difference),
        *(printable(f"note: {note}") for note in comparison.notes),
    )


def strategies(folder: Path, /, *, json: bool = False) -> None:
    """Group partners by behaviour: forces, distance, joint travel, first contact and success.

    A partner's behaviour is that of the pair with its best robot in the cross-play.

    Args:
        folder: Folder that `assistax-zoo crossplay --out` filled.
        json: Print JSON.

    Example:
        assistax-zoo strategies xp
    """
    from evaluation.figures.strategies import summarise_strategies
    from evaluation.record import tables
    from evaluation.record.verification import check_whole

    check_whole(folder)
    groups = summarise_strategies(tables.read_parquet(folder / tables.PAIRS_FILE))
    if json:
        print_json(groups)
    else:
        _print_strategies(groups)


def report(folder: Path, /, *, out: Path) -> None:
    """Write one page about a finished evaluation or cross-play, for a browser.

    It has figures, tables, command, versions and hashes, and loads nothing from elsewhere; a
    cross-play can be zoomed and searched in it.

    Args:
        folder: Folder that `assistax-zoo evaluate --out` or `crossplay --out` filled.
        out: Page to write, .html.

    Example:
        assistax-zoo report xp --out report.html
    """
    from evaluation.report import write_report

    write_report(folder, out)
    print(out)


def _difference_line(side: str, difference: "Difference") -> str:
    from evaluation.figures.bootstrap import scope

    ends, chance = difference.mean_ci, difference.p_positive
    interval = "" if ends is None else " [{:+.1f}, {:+.1f}]".format(*ends)
    certainty = "" if chance is None else f", P(A > B) {chance:.3f}"
    return (
        f"  {side:5} partners: mean {difference.mean:+.1f}{interval}, "
        f"{scope(difference.generalises_to)}{certainty}; "
        f"better with {difference.partners_better:.0%} of partners"
    )


# Heads of columns whose names are too wide for a table of 80 characters.
_NARROW = {"success": ("goal", "met", "share"), "distance_mean": ("tool", "away", "m")}


def _print_strategies(strategies: dict[str, Any]) -> None:
    from rich.text import Text

    medoids = [cluster["medoid"] for cluster in strategies["clusters"]]
    tasks = {name.partition("/")[0] for name in medoids}
    of_task = f"{tasks.pop()}/" if len(tasks) == 1 else ""  # which all of them have
    table = new_table("partners by behaviour with their best robot")
    table.add_column("")
    table.add_column("medoid", no_wrap=True)
    table.add_column("size", justify="right")
    for name, unit in strategies["features"].items():
        words = _NARROW.get(name) or [*name.split("_"), unit]
        table.add_column("\n".join(words), justify="right")
    for i, cluster in enumerate(strategies["clusters"]):
        figures = [_figure(cluster["mean"][name]) for name in strategies["features"]]
        name = cluster["medoid"].removeprefix(of_task).removesuffix("/human")
        medoid = Text(printable(name))  # not rich's markup either
        table.add_row(chr(ord("A") + i), medoid, str(len(cluster["members"])), *figures)
    print_table(table)
    if len(strategies["clusters"]) == 1:
        print("no clear clusters: all partners are one")
    diversity = strategies["br_div"]
    lines = [
        f"BR-Div: rank {diversity['rank']} of {diversity['n']}, participation "
        f"{diversity['participation_ratio']:.2f}",
        f"a diverse subset: {', '.join(strategies['diverse_subset'])}",
    ]
    if pair := strategies["incompatible"]:
        exchanged = " and ".join(f"{value:.0f}" for value in pair["returns_exchanged"])
        own = " and ".join(f"{value:.0f}" for value in pair["returns"])
        names = " and ".join(pair["partners"])
        lines.append(
            f"most incompatible: {names}: {own} with their own robots, {exchanged} with each "
            "other's"
        )
    print(
        *(
            textwrap.fill(printable(line), 80, subsequent_indent="  ", break_on_hyphens=False)
            for line in lines
        ),
        sep="\n",
    )


def _figure(value: float) -> str:
    """Return a number in five characters, where it is below 10,000."""
    return f"{value:.{2 if abs(value) < 10 else 1 if abs(value) < 100 else 0}f}"
