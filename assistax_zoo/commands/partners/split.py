"""Commands over splits: list, show, create, verify."""

from pathlib import Path
from typing import Any

from assistax_base.errors import ZooError, counted, listing
from assistax_envs.versions import TASKS
from assistax_zoo.commands.options import parse_names
from assistax_zoo.commands.partners.listing import table_lines
from assistax_zoo.shell.console import answer, first_lines
from zoo.partners.person_tables import person_splits
from zoo.registry import Registry, load_registry
from zoo.schema import Rule, Split
from zoo.splits import partner_teams
from zoo.splitting.create import create_split
from zoo.splitting.rules import LEAVE_ONE_OUT, THREE


def list_splits(
    *, task: str | None = None, registry: Path | None = None, json: bool = False
) -> None:
    """List the splits; a release's default is marked.

    Args:
        task: Only this task.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split list --task scratch
    """
    loaded = load_registry(registry)
    splits = [split for split in loaded.splits if task in (None, split.task)]
    splits += [
        split for of in TASKS if task in (None, of) for split in person_splits(loaded.data, of)
    ]
    defaults = {
        release.splits.get(task) or loaded.split(task, release=name).id
        for name, release in loaded.data.releases.items()
        for task in {**release.splits, **release.persons}
    }
    table = [{**_brief(split), "default": split.id in defaults} for split in splits]
    names = ("id", "n_train", "n_validation", "n_test")
    rows = [(*(str(row[name]) for name in names), "yes" * row["default"]) for row in table]
    columns = ("split", "train", "valid.", "test", "default")
    answer(json, table, *table_lines(columns, rows, counted(len(splits), "split")))


def show(id: str, *, registry: Path | None = None, json: bool = False) -> None:
    """Show a split: rule, sha256, and the teams of its sides.

    Args:
        id: A split's id, or a task for its default split.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split show scratch
    """
    task, _, rest = id.partition("/")
    split = load_registry(registry).split(task, id if rest else None)
    lines = [f"{name:8} {value}" for name, value in _brief(split).items()]
    for side, teams in split.sides.items():
        preferences = ", ".join(split.preferences.get(side, ()))
        lines += [
            f"\n{side}{f', under {preferences}' if preferences else ''}",
            *(f"  {team}" for team in teams),
        ]
    answer(json, split.model_dump(mode="json"), *lines)


def create(
    *,
    task: str,
    rule: Rule = "half",
    release: str | None = None,
    seed: int = 0,
    held_out: str | None = None,
    n: int = 5,
    train: tuple[str, ...] = (),
    test: tuple[str, ...] = (),
    train_preferences: str = "",
    test_preferences: str = "",
    best_responses: tuple[Path, ...] = (),
    conventions: Path | None = None,
    default: bool = False,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Make a split of a release's partners, which other commands then know.

    It is kept among your own. Partners that act nearly as one of another side may be left out.

    Args:
        task: Task of the split.
        rule: How the partners are divided.
        release: Release of the partners, such as own:v0; default the newest that has the task.
        seed: Seed of the rules half, small-train and three-sides.
        held_out: Algorithm or disability setting that a leave-one-out rule tests on.
        n: Training partners of small-train.
        train: Team ids or globs of a custom split's train side; repeat the option for more.
        test: Team ids or globs of a custom split's test side.
        train_preferences: Preferences of its humans, such as p2,p3; default all others.
        test_preferences: Preferences of the test side's humans, such as p1,p5,p9, for any rule.
        best_responses: Finished evaluation or cross-play. With it three-sides leaves out partners
            with whom the best robot earns less than a quarter of the median. Repeat it for more.
        conventions: Finished cross-play, by whose two groups of humans three-sides stratifies.
        default: Make it the release's default split of the task, in a registry of your own.
        registry: Registry of your own to write to, for a split of its partners.
        json: Print JSON.

    Example:
        assistax-zoo split create --task scratch --rule leave-one-disability-out --held-out d9
    """
    loaded = load_registry(registry)
    where = {"task": task, "release": release, "rule": rule}
    split = create_split(
        registry,
        **where,
        train=_teams(loaded, train),
        test=_teams(loaded, test),
        seed=seed,
        held_out=held_out,
        n=n,
        default=default,
        train_preferences=parse_names(train_preferences),
        test_preferences=parse_names(test_preferences),
        earned=_earned(best_responses, loaded, task),
        groups=_groups(conventions, loaded, task),
    )
    answer(json, split.model_dump(mode="json"), *_created(split, loaded))


def _created(split: Split, registry: Registry) -> list[str]:
    """Return lines with the number of teams on each side, and the teams left out."""
    counts = ", ".join(f"{len(teams)} {side}" for side, teams in split.sides.items())
    partners = partner_teams(registry.data, split.task, split.release)
    rest = sorted(set(partners).difference(*split.sides.values()))
    why = _LEFT_OUT.get(split.rule)
    left = [f"left out, because {why}: {', '.join(rest)}"] if rest and why else []
    return [f"split {split.id}: {counts}", *left]


def verify(id: str | None = None, *, registry: Path | None = None, json: bool = False) -> None:
    """Check splits: sha256, known teams, nothing on both sides; exit code 1 if anything is wrong.

    Two humans that act nearly alike count as one human, though their hashes differ;
    `zoo/splitting/similar_humans.py` says how nearly.

    Args:
        id: A split's id; all splits if not given.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split verify
    """
    from zoo.splitting.similar_humans import similar_leak, similar_pairs

    loaded = load_registry(registry, roots=False)
    named = [loaded.split(id.partition("/")[0], id)] if id else loaded.splits
    names = [split.id for split in named]
    problems: dict[str, str] = {}
    for name in names:
        try:
            alike = similar_pairs(loaded, loaded.split(name.partition("/")[0], name))
            if alike:
                problems[name] = str(similar_leak(name, alike))
        except ZooError as error:
            problems[name] = str(error)
    verdict = f"{len(names) - len(problems)} of {counted(len(names), 'split')} verified"
    content = {"ok": not problems, "splits": names, "problems": problems}
    answer(json, content, *first_lines("", [*problems.values()], "problem"), verdict)
    if problems:
        raise SystemExit(1)


_LEFT_OUT = {
    **dict.fromkeys(LEAVE_ONE_OUT, "they act nearly as a test partner does"),
    THREE: "nobody earns much with them, or they act nearly as a partner of another side does",
}


def _earned(folders: tuple[Path, ...], registry: Registry, task: str) -> dict[str, float]:
    """Return the best robot's return with each team's human, over finished folders."""
    from evaluation.record.record import Record

    earned: dict[str, float] = {}
    for folder in folders:
        _check_partners(folder, registry, task)
        returns = Record.read(folder).returns
        best = zip(returns.partners["partner_team"], returns.scores.max(axis=0), strict=True)
        earned |= {t: max(float(value), earned.get(t, float("-inf"))) for t, value in best if t}
    return earned


def _groups(folder: Path | None, registry: Registry, task: str) -> dict[str, str]:
    """Return the convention groups of a finished cross-play."""
    if folder is None:
        return {}
    from evaluation.figures.clustering import convention_groups
    from evaluation.record import tables

    _check_partners(folder, registry, task)
    return convention_groups(tables.read_parquet(folder / tables.PAIRS_FILE))


def _check_partners(folder: Path, registry: Registry, task: str) -> None:
    """Refuse a finished folder that was played with other partners than the registry's."""
    from evaluation.record.alike import read_identity
    from evaluation.record.verification import check_whole

    check_whole(folder)
    identity = read_identity(folder)
    if identity is None or identity["task"] != task:
        raise ValueError(
            f"{folder} is of {'no job that it names' if identity is None else identity['task']}; "
            f"give a finished folder of {task}"
        )
    played = {row[0]: row[3] for row in identity["partners"]}
    here = {entry.id: entry.sha256 for entry in registry.known(played)}
    if other := [name for name, digest in here.items() if played[name] != digest]:
        raise ValueError(
            f"{folder} was played with other partners than this registry's: "
            f"{listing(other, 3)} {'has' if len(other) == 1 else 'have'} another sha256; give a "
            "folder of this registry"
        )


def _teams(registry: Registry, patterns: tuple[str, ...]) -> list[str]:
    entries = registry.select(patterns, role="human") if patterns else []
    return sorted({entry.team for entry in entries})


def _brief(split: Split) -> dict[str, Any]:
    exclude = {"train", "validation", "test", "preferences"}
    content = split.model_dump(mode="json", exclude=exclude, exclude_none=True)
    return content | {
        f"n_{side}": len(getattr(split, side)) for side in ("train", "validation", "test")
    }
