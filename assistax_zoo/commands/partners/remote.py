"""Commands between this machine and others: fetch, add, remove, publish, lock, config."""

import contextlib
from collections.abc import Callable, Sequence
from itertools import starmap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from assistax_base.errors import counted, printable
from assistax_zoo.shell.console import answer, confirm, progress
from zoo.ids import release_number
from zoo.locations import default_remote, set_default_remote
from zoo.lock import locked_entries, read_lock
from zoo.locking import make_lock, write_lock
from zoo.namespaces import plain_name, split_namespace
from zoo.registry import Registry, load_registry
from zoo.schema import PolicyEntry
from zoo.transport.addresses import open_remote

if TYPE_CHECKING:
    from zoo.transport.fetch import Report


def fetch(
    pattern: str | None = None,
    *,
    from_: Annotated[str | None, Parameter(name="--from")] = None,
    task: str | None = None,
    algorithm: str | None = None,
    disability: str | None = None,
    role: Literal["robot", "human"] | None = None,
    release: str | None = None,
    lock: Path | None = None,
    registry: Path | None = None,
    yes: bool = False,
    json: bool = False,
) -> None:
    """Fetch partners from a remote into the cache; files that are present are verified.

    The cache is ~/.cache/assistax-zoo, or $ASSISTAX_ZOO_CACHE. An interrupted fetch continues where
    it was.

    Args:
        pattern: Glob over policy ids, such as `'scratch/ippo-*/human'`; everything if not given.
        from_: Folder, https://..., hf://org/name or hf://org/name@revision; default
            $ASSISTAX_ZOO_REMOTE, or what `assistax-zoo config remote` set.
        task: Only this task.
        algorithm: Only this algorithm.
        disability: Only this disability setting, such as d3.
        role: Only this role.
        release: Only this release, such as v1.
        lock: Only what this lock file pins.
        registry: Registry that says which bytes; default the remote's with --from, else the
            installed one.
        yes: Accept another default split or release than the remote had before, without a question.
        json: Print JSON.

    Example:
        assistax-zoo fetch 'scratch/ippo-*/human' --from hf://org/name@v1
    """
    from zoo.transport.fetch import fetch as fetch_entries
    from zoo.transport.fetch import remote_registry

    text = from_ or default_remote()
    remote = open_remote(text) if text else None
    theirs = remote if from_ and not registry else None
    loaded = (
        remote_registry(theirs, _accept(theirs.name, yes)) if theirs else load_registry(registry)
    )
    fields = {"algorithm": algorithm, "disability": disability, "role": role, "release": release}
    entries = _pinned(loaded, loaded.select(pattern, task=task, **fields), lock)
    what = f"fetch {remote.name if remote else ''}"
    with contextlib.ExitStack() as stack:
        report = fetch_entries(
            loaded,
            entries,
            remote,
            on_total=lambda size: stack.enter_context(progress(what, size, is_bytes=True)),
        )
    lines = _report_lines(report)
    if theirs:
        lines += [f"its registry is {report.registry}: give it to other commands with --registry"]
    answer(json, vars(report), *lines)


def _pinned(registry: Registry, entries: list[PolicyEntry], lock: Path | None) -> list[PolicyEntry]:
    """Return the entries that a lock file pins; all without one."""
    if lock is None:
        return entries
    pinned = {entry.id for entry in locked_entries(registry, read_lock(lock))}
    return [entry for entry in entries if entry.id in pinned]


def add(
    remote: str,
    *,
    as_: Annotated[str, Parameter(name="--as")],
    yes: bool = False,
    json: bool = False,
) -> None:
    """Add another zoo beside the installed one: its policies are then NAME:scratch/... everywhere.

    The same command again updates it and shows what changed. Fetch its parameters like any others:
    `assistax-zoo fetch 'NAME:*'`.

    Args:
        remote: Folder, https://..., hf://org/name or hf://org/name@revision.
        as_: Name in lower case, which goes before the ids.
        yes: Accept another default split or release than the zoo had before, without a question.
        json: Print JSON.

    Example:
        assistax-zoo add hf://lab/zoo --as lab
    """
    from zoo.transport.other_zoos import add as add_zoo

    added = add_zoo(remote, as_, _accept(remote, yes))
    count = len(added.policies)
    line = f"{counted(count, 'policy')} as {as_}:...; next: assistax-zoo fetch '{as_}:*'"
    answer(json, {"name": as_, "policies": count, "registry": added.path}, line)


def remove(name: str) -> None:
    """Forget a zoo that was added; parameters that were fetched stay in the cache.

    Args:
        name: The name it was added under.

    Example:
        assistax-zoo remove lab
    """
    from zoo.transport.other_zoos import remove as remove_zoo

    remove_zoo(name)
    print(f"removed {name}")


def config_remote(remote: str | None = None, *, forget: bool = False) -> None:
    """Show or set the remote that is used if a command names none.

    Args:
        remote: Folder, https://... or hf://org/name.
        forget: Remove the setting.

    Example:
        assistax-zoo config remote hf://org/name
    """
    if remote or forget:
        set_default_remote(open_remote(remote).name if remote else None)
    print(printable(default_remote() or "no remote"))


def lock(
    pattern: str | None = None,
    *,
    task: str | None = None,
    release: str | None = None,
    split: tuple[str, ...] = (),
    out: Path = Path("assistax-zoo.lock"),
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Write a lock file for a paper: the release's root, split, and sha256 of every policy.

    `evaluate --lock`, `crossplay --lock` and `fetch --lock` then refuse or leave out everything
    else.

    Args:
        pattern: Glob over policy ids to pin; all of the release if not given.
        task: Only this task.
        release: Release to pin; default the newest that one of the tasks has by default.
        split: Split to pin instead of a task's default one, as TASK/NAME, or NAME with --task;
            repeat it for more tasks.
        out: File to write.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo lock 'scratch/*' --release v1 --out assistax-zoo.lock
    """
    loaded = load_registry(registry)
    if release is None:
        matching = loaded.select(pattern, task=task)
        own = [entry for entry in matching if ":" not in entry.release] or matching
        zoos = {(entry.task, split_namespace(entry.release)[0]) for entry in own}
        release = max(starmap(loaded.release_of, zoos), key=release_number)
    entries = loaded.select(pattern, task=task, release=release)
    made = make_lock(loaded, entries, dict(_task_split(name, task) for name in split))
    write_lock(made, out)
    lines = [f"locked {counted(len(made.policies), 'policy')} of release {made.release} in {out}"]
    for name in made.environments:
        pinned = made.splits.get(name)
        text = f"split {pinned.id}" if pinned else "no split: not all its partners are locked"
        lines.append(f"  {name}: {text}")
    shards = {entry.shard: loaded.data.shards[entry.shard].sha256 for entry in entries}
    answer(json, {"lock": out, **made.model_dump(mode="json"), "shards": shards}, *lines)


def _accept(remote: str, yes: bool) -> Callable[[Sequence[str]], bool]:
    return lambda changes: confirm(f"{remote} changed; take it?", changes, yes)


def _task_split(name: str, task: str | None) -> tuple[str, str]:
    """Return the task that a split's name says, or `task`, and the name."""
    rest = plain_name(name)
    said, slash, _ = rest.partition("/")
    if not slash and task is None:
        raise ValueError(f"split is {name!r}; name its task too, as TASK/{rest}")
    return (said if slash else task or ""), name


def _report_lines(report: "Report") -> list[str]:
    here = f", {report.present} already here" if report.present else ""
    lines = [
        f"verified {counted(report.policies, 'policy')} in {counted(report.shards, 'shard')}{here}"
    ]
    if report.bytes:
        size, seconds = report.bytes / 1e6, max(report.seconds, 1e-3)
        commit = f" at commit {report.revision}" if report.revision else ""
        lines += [
            f"fetched {size:.1f} MB from {report.remote}{commit} in {report.seconds:.1f} s "
            f"({size / seconds:.0f} MB/s)"
        ]
    return lines
