"""Commands over the published population: list, show, verify, publish, split."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assistax_zoo.console import print_json

if TYPE_CHECKING:
    from zoo.registry import Registry
    from zoo.schema import SelfPlay, Split

RoleName = Literal["robot", "human"]
RuleName = Literal["half", "leave-one-algorithm-out", "leave-one-disability-out", "small-train", "custom"]


def list_policies(
    pattern: str | None = None,
    *,
    task: str | None = None,
    algorithm: str | None = None,
    disability: str | None = None,
    role: RoleName | None = None,
    release: str | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """List the published policies.

    Args:
        pattern: Glob over policy ids, such as 'scratch/ippo-*/human'; a team's id lists both its policies.
        task: Only this task.
        algorithm: Only this algorithm.
        disability: Only this disability setting, such as d3.
        role: Only this role.
        release: Only this release, such as v0.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo list 'scratch/ippo-*/human' --disability d3
    """
    from zoo.index import read_index
    from zoo.selection import select

    fields = {"algorithm": algorithm, "disability": disability, "role": role, "release": release}
    entries = select(read_index(registry), pattern, task=task, **fields)
    if json:
        print_json([entry.to_json() for entry in entries])
        return
    rows = [(entry.id, *_figures(entry.self_play)) for entry in entries]
    _print_table(("policy", "self-play", "95% interval", "episodes"), rows, f"{len(entries)} policies")


def show(id: str, *, registry: Path | None = None, json: bool = False) -> None:
    """Show the card of a policy or a team: spec, provenance, self-play, splits, bytes.

    Args:
        id: A policy's id, or a team's for both its policies.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo show scratch/ippo-d3-s5-v0/human
    """
    from zoo.registry import load_registry

    loaded = load_registry(registry)
    members = [entry.id for entry in loaded.policies if id in (entry.id, entry.team)]
    cards = [_card(loaded, policy) for policy in members or [loaded.policy(id).id]]
    if json:
        print_json(cards if id not in members else cards[0])
        return
    for card in cards:
        _print_card(card)


def verify(*, registry: Path | None = None, json: bool = False) -> None:
    """Check every published byte, split and reference; exit code 1 if anything is wrong.

    Args:
        registry: Registry to check instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo verify
    """
    from zoo.registry import load_registry
    from zoo.verify import verify as verify_registry

    report = verify_registry(load_registry(registry))
    if json:
        print_json(report.to_json())
    else:
        for problem in report.problems:
            print(f"problem: {problem}")
        for note in report.notes:
            print(f"note: {note}")
        counts = f"{report.shards} shards ({report.bytes} bytes), {report.policies} policies, {report.splits} splits"
        print(f"{'verified' if report.ok else f'{len(report.problems)} problems in'} {counts} of {report.registry}")
    if not report.ok:
        raise SystemExit(1)


def publish(
    *runs: Path,
    release: str,
    registry: Path | None = None,
    date: str | None = None,
    description: str = "",
    json: bool = False,
) -> None:
    """Publish the teams of run folders in a release: shards, registry and default split.

    What is published never changes; the same run again is a no-op.

    Args:
        runs: Run folders that `assistax-zoo train` wrote.
        release: Release that the teams join, such as v0; it is made if it does not exist.
        registry: Registry to publish to instead of the installed one; it is made if it does not exist.
        date: ISO date of a new release; default today.
        description: One sentence on a new release.
        json: Print JSON.

    Example:
        assistax-zoo publish runs/scratch-ippo-d1 runs/scratch-ippo-d9 --release v0 --registry registry.json
    """
    from zoo.files import registry_path
    from zoo.index import read_index
    from zoo.publish import publish as publish_teams
    from zoo.runs import read_run

    if not runs:
        raise ValueError("no run folder given; name at least one, for example runs/scratch-ippo-d1")
    path = registry_path(registry)
    before = {entry.id for entry in read_index(path)} if path.exists() else set()
    teams = [team for run in runs for team in read_run(run)]
    result = publish_teams(teams, path, release, date=date, description=description)
    added = [entry.id for entry in result.policies if entry.id not in before]
    if json:
        print_json({"registry": path, "release": release, "added": added, "policies": len(result.policies)})
    else:
        print(f"published {len(added)} new policies in release {release} of {path}; it holds {len(result.policies)}")


def split_list(*, task: str | None = None, registry: Path | None = None, json: bool = False) -> None:
    """List the splits; a release's default is marked.

    Args:
        task: Only this task.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split list --task scratch
    """
    from zoo.registry import load_registry

    loaded = load_registry(registry)
    splits = [split for split in loaded.splits if task in (None, split.task)]
    defaults = {split for release in loaded.data.releases.values() for split in release.splits.values()}
    if json:
        print_json([{**_brief(split), "default": split.id in defaults} for split in splits])
        return
    rows = [
        (split.id, split.rule, str(len(split.train)), str(len(split.test)), "yes" if split.id in defaults else "")
        for split in splits
    ]
    _print_table(("split", "rule", "train", "test", "default"), rows, f"{len(splits)} splits")


def split_show(id: str, *, registry: Path | None = None, json: bool = False) -> None:
    """Show a split: rule, sha256, and the teams of both sides.

    Args:
        id: A split's id, or a task for its default split.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split show scratch
    """
    from zoo.registry import load_registry

    task, _, rest = id.partition("/")
    split = load_registry(registry).split(task, id if rest else None)
    if json:
        print_json(split.model_dump(mode="json"))
        return
    for name, value in _brief(split).items():
        print(f"{name:8} {value}")
    for side in ("train", "test"):
        print(f"\n{side}\n" + "\n".join(f"  {team}" for team in getattr(split, side)))


def split_create(
    *,
    task: str,
    rule: RuleName = "half",
    release: str | None = None,
    seed: int = 0,
    held_out: str | None = None,
    n: int = 5,
    train: tuple[str, ...] = (),
    test: tuple[str, ...] = (),
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Make a split of a release's partners and write it to the registry.

    Args:
        task: Task of the split.
        rule: How the partners are divided.
        release: Release of the partners; default the newest.
        seed: Seed of the rules half and small-train.
        held_out: Algorithm or disability setting that a leave-one-out rule tests on.
        n: Training partners of small-train.
        train: Team ids or globs of a custom split's train side; repeat the option for more.
        test: Team ids or globs of a custom split's test side.
        registry: Registry to write to instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split create --task scratch --rule leave-one-disability-out --held-out d9
    """
    from zoo.registry import load_registry
    from zoo.release import create_split

    loaded = load_registry(registry)
    sides = {"train": _teams(loaded, train), "test": _teams(loaded, test)}
    split = create_split(loaded.path, task=task, release=release, rule=rule, seed=seed, held_out=held_out, n=n, **sides)
    if json:
        print_json(split.model_dump(mode="json"))
    else:
        print(f"split {split.id}: {len(split.train)} train, {len(split.test)} test, in {loaded.path}")


def split_verify(id: str | None = None, *, registry: Path | None = None, json: bool = False) -> None:
    """Check splits: content against sha256, known teams, nothing on both sides; exit code 1 if anything is wrong.

    Args:
        id: A split's id; all splits if not given.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo split verify
    """
    from zoo.errors import ZooError
    from zoo.registry import load_registry

    loaded = load_registry(registry)
    names = [loaded.split(id.partition("/")[0], id).id] if id else [split.id for split in loaded.splits]
    problems: dict[str, str] = {}
    for name in names:
        try:
            loaded.split(name.partition("/")[0], name)
        except ZooError as error:
            problems[name] = str(error)
    if json:
        print_json({"ok": not problems, "splits": names, "problems": problems})
    else:
        print("\n".join([*problems.values(), f"{len(names) - len(problems)} of {len(names)} splits verified"]))
    if problems:
        raise SystemExit(1)


def _teams(registry: "Registry", patterns: tuple[str, ...]) -> list[str]:
    return sorted({entry.team for entry in registry.select(patterns, role="human")}) if patterns else []


def _card(registry: "Registry", policy: str) -> dict[str, Any]:
    entry = registry.policy(policy)
    sides = {split.id: split.side(entry.team) for split in registry.splits}
    return {
        "id": entry.id,
        "team": entry.team,
        "release": entry.release,
        "disability": {"setting": entry.disability, **registry.data.disability_settings[entry.disability].model_dump()},
        "spec": entry.spec.to_json(),
        "self_play": _plain_figures(entry.self_play),
        "training": {"run": entry.run, "seed": entry.seed, **entry.training.model_dump(mode="json")},
        "splits": {split: side for split, side in sides.items() if side},
        "shard": {"path": entry.shard, "row": entry.row, "sha256": registry.data.shards[entry.shard].sha256},
        "sha256": entry.sha256,
    }


def _plain_figures(self_play: "SelfPlay | None") -> dict[str, Any] | None:
    return self_play.model_dump(mode="json") if self_play else None


def _brief(split: "Split") -> dict[str, Any]:
    content = split.model_dump(mode="json", exclude={"train", "test"}, exclude_none=True)
    return {**content, "n_train": len(split.train), "n_test": len(split.test)}


def _print_card(card: dict[str, Any]) -> None:
    print(card["id"])
    for name, value in card.items():
        if isinstance(value, dict):
            print(f"  {name}")
            for key, item in value.items():
                print(f"    {key:18} {_text(item)}")
        elif name != "id":
            print(f"  {name:20} {'not measured' if value is None else value}")


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {item}" for key, item in value.items()) or "-"
    return "-" if value is None else str(value)


def _figures(self_play: dict[str, Any] | None) -> tuple[str, str, str]:
    if self_play is None:
        return "not measured", "", ""
    low, high = self_play["ci"]
    return f"{self_play['mean']:.1f}", f"{low:.1f} to {high:.1f}", str(self_play["n"])


def _print_table(columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> None:
    """Print a table on a terminal, and plain aligned columns into a pipe or file."""
    if sys.stdout.isatty():
        from rich import box
        from rich.console import Console
        from rich.table import Table

        table = Table(*columns, caption=caption, caption_justify="left", box=box.SIMPLE_HEAD)
        for row in rows:
            table.add_row(*row)
        Console().print(table)
        return
    lines = [columns, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())
    print(caption)
