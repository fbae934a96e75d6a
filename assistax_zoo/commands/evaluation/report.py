"""Commands that read finished folders: differences of methods, strategies, and a page."""

import tempfile
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_base.errors import counted, printable
from assistax_zoo.commands.evaluation.render import EPISODE
from assistax_zoo.shell.console import (
    answer,
    new_table,
    print_json,
    print_table,
    progress,
    stdout_is_data,
)

if TYPE_CHECKING:
    from assistax_zoo.comparing import Comparison
    from evaluation.figures.metrics import Difference


def compare(
    *folders: Path, contrasts: Path | None = None, seed: int = 0, json: bool = False
) -> None:
    """Compare method A with method B: paired differences A - B over the same partners and episodes.

    Both means are of the partners that A and B have in common, without those that a robot of either
    met in training. Folders that were played otherwise are refused.

    With --contrasts, compare as a file says that was written before the test side was played: each
    named method less its baseline, with p-values corrected for all of them, and the difference
    that could have been seen. A folder's name is its method's.

    Args:
        folders: A and B, which `assistax-zoo evaluate --out` filled, of the same task, split,
            episodes and seed; with --contrasts a folder for each method and task, or a league's of
            a task.
        contrasts: File of named contrasts, TOML or JSON; docs/league.md shows one.
        seed: Seed of the bootstrap.
        json: Print JSON.

    Example:
        assistax-zoo compare results/mine results/baseline
    """
    from assistax_zoo.comparing import compare as compare_results

    if contrasts is not None:
        _compare_named(contrasts, folders, seed, json)
        return
    if len(folders) != 2:
        raise ValueError(
            f"{counted(len(folders), 'folder')} to compare; give two, or a file of contrasts"
        )
    a, b = folders
    comparison = compare_results(a, b, seed=seed)
    from evaluation.record.columns import SIDES

    sides = [(side, getattr(comparison, side)) for side in SIDES]
    answer(
        json,
        {"a": str(a), "b": str(b), **comparison.to_json()},
        f"{comparison.task}: return of {a} minus return of {b}",
        *(_difference_line(side, difference) for side, difference in sides if difference),
        *_care_lines(comparison),
        *(printable(f"note: {note}") for note in comparison.notes),
    )


def _compare_named(file: Path, folders: Sequence[Path], seed: int, json: bool) -> None:
    """Print the contrasts of a file."""
    from assistax_zoo.comparing import compare_named
    from evaluation.record import tables

    figures = compare_named(file, folders, seed=seed)
    if json:
        print_json(tables.to_json(figures))
        return
    table = new_table(f"contrasts on the test side, alpha {figures.alpha:g} for all")
    table.add_column("method less baseline", overflow="fold")
    for name in ("mean", "95%\ninterval", "p", "p\nHolm", "detect-\nable"):
        table.add_column(name, justify="right")
    for figure in figures.contrasts:
        digits = 1 if figure.metric == "return" else 3
        mean, ends = figure.difference.mean, figure.difference.mean_ci
        named = figure.p_holm is not None
        table.add_row(
            printable(f"{figure.method} - {figure.baseline}, {figure.task}, {figure.metric}: ")
            + _common_means(figure.difference, digits),
            f"{mean:+.{digits}f}",
            " ".join(f"{end:+.{digits}f}" for end in ends or ()) or "-",
            f"{figure.p:.4f}",
            f"{figure.p_holm:.4f}{' *' if figure.found else ''}" if named else "not named",
            f"{figure.detectable:.{digits}f}",
        )
    print_table(table)
    print(printable(f"named in {figures.file}, sha256 {figures.sha256}"))
    for note in figures.notes:
        print(printable(f"note: {note}"))


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


def report(
    folder: Path,
    /,
    *,
    out: Path,
    contrasts: Path | None = None,
    watch: bool = False,
    run_code: bool = False,
    registry: str | None = None,
) -> None:
    """Write one page about a finished evaluation or cross-play, or a league, for a browser.

    It has figures, tables, command, versions and hashes, and loads nothing from elsewhere; a
    cross-play can be zoomed and searched in it.

    Args:
        folder: Folder that `assistax-zoo evaluate --out` or `crossplay --out` filled; or one of
            such evaluations, in folders of their rows' names: a league on one task.
        out: Page to write, .html.
        contrasts: File of named contrasts, whose figures a league's page has.
        watch: Play the pair that earns least again, and show its first episode in the page. The
            robot is one of the registry, or its file lies in the folder.
        run_code: Play a robot from Python code, or a file elsewhere, that the folder names; read it
            first.
        registry: Registry to read instead of the installed one: a file, a folder or an address.

    Example:
        assistax-zoo report xp --out report.html
    """
    from evaluation.report import write_report

    figures = None
    if contrasts is not None:
        from assistax_zoo.comparing import compare_named

        figures = compare_named(contrasts, [folder])
    with stdout_is_data():
        episodes = [_worst_episode(folder, registry, run_code=run_code)] if watch else []
        write_report(folder, out, episodes, contrasts=figures)
    print(out)


def _worst_episode(folder: Path, registry: str | None, *, run_code: bool) -> bytes:
    """Play the first episode of the pair of a folder that earns least, as its page takes it."""
    from assistax_zoo.recording import trajectories
    from assistax_zoo.zoos import open_zoo
    from evaluation.player.episode import episode_content, read_episode
    from evaluation.player.page import pack
    from evaluation.player.worst_pair import worst_pair

    opened = open_zoo(registry)
    pair = worst_pair(folder, opened.registry, run_code=run_code)
    with (
        tempfile.TemporaryDirectory(prefix="report-") as place,
        progress(f"play {pair['task']}", EPISODE) as advance,
    ):
        out = Path(place) / "worst.trajectory"
        pair |= {"episodes": 1, "backend": "native", "on_step": lambda: advance(1)}
        trajectories(**pair, zoo=opened, out=out)
        return pack(episode_content(read_episode(out)))


def _common_means(difference: "Difference", digits: int) -> str:
    """Print the two means whose difference is compared."""
    first, second = difference.means
    seeds = " and ".join(map(str, difference.seeds))
    return (
        f"{first:.{digits}f} and {second:.{digits}f}, {seeds} seeds, "
        f"{counted(difference.partners, 'partner')}"
    )


def _difference_line(side: str, difference: "Difference") -> str:
    from evaluation.figures.bootstrap import scope

    ends, chance = difference.mean_ci, difference.p_positive
    interval = "" if ends is None else " [{:+.1f}, {:+.1f}]".format(*ends)
    certainty = "" if chance is None else f", P(A > B) {chance:.3f}"
    return (
        f"  {side:5} partners: mean {difference.mean:+.1f}{interval}, "
        f"{scope(difference.generalises_to)}{certainty}; "
        f"better with {difference.partners_better:.0%} of partners; means "
        f"{_common_means(difference, 1)}"
    )


def _care_lines(comparison: "Comparison") -> list[str]:
    """Return the lines about care in a gentle task."""
    lines = [
        f"  {name.replace('_', ' ')}: {difference.mean:+.3f}"
        + (" [{:+.3f}, {:+.3f}]".format(*difference.mean_ci) if difference.mean_ci else "")
        + f"; {_common_means(difference, 3)}"
        for name, difference in comparison.care.items()
    ]
    for wish, slopes in comparison.slopes.items():
        both = " and ".join("-" if slope is None else f"{slope.value:.2f}" for slope in slopes)
        lines.append(f"  adaptation slope, {wish}: {both}")
    return lines


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
