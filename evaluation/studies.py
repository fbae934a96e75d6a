"""The two jobs that users run: M_test of a robot, and the cross-play of a population. Each fills a folder."""

import dataclasses
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from assistax_envs.versions import TASKS, VERSIONS
from evaluation import tables
from evaluation.evaluator import Evaluation, Progress, check_folder, run_block, run_job
from evaluation.jobs import Ego, Group, Job
from evaluation.spread import run_blocks_on_ray
from population.engines import RayCluster
from zoo.errors import RegistryVersionError, SplitError, listing
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split

if TYPE_CHECKING:
    from assistax_envs import Env

FIGURE_FILE = "crossplay.png"
SIDE_WORDS = {"test": ("test",), "train": ("train",), "both": ("train", "test")}


@dataclasses.dataclass(frozen=True)
class Settings:
    """What both jobs have in common."""

    task: str
    episodes: int  # of each pair
    seed: int = 0  # of the episodes; the same for every pair
    backend: str = "auto"
    stochastic: bool = False  # draw actions instead of taking each policy's mode
    max_envs: int | None = None  # simulations at once; None is the backend's default

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise ValueError(f"task is {self.task!r}; allowed are {', '.join(TASKS)}")
        if self.episodes < 1:
            raise ValueError(
                f"episodes is {self.episodes}; each pair needs at least 1 (--episodes 8)"
            )
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; allowed is 0 or more")
        if self.max_envs is not None and self.max_envs < 1:
            raise ValueError(f"max_envs is {self.max_envs}; allowed is 1 or more")


def evaluate_policies(
    registry: Registry,
    policies: Sequence[Any],
    settings: Settings,
    folder: Path,
    *,
    split: str | None = None,
    partners: str | Sequence[str] | None = None,
    references: Path | None = None,
    crossplay: Path | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> dict[str, Any]:
    """Evaluate robots, seeds of one method, against the partners of a split; return what `evaluate --json` prints.

    Args:
        registry: The published partners.
        policies: The robots, see `evaluation.egos.read_egos`.
        settings: Task, episodes and the rest.
        folder: Filled with the episodes and every table drawn from them; a run that was stopped
            goes on.
        split: "test", "train" or "both" sides of the default split, or a split's id, ":train" or
            ":both" added.
        partners: Globs over partners to use instead of whole sides; see `choose_partners`.
        references: Folder that keeps the episodes of reference egos, see `evaluation.references`;
            None plays none.
        crossplay: Folder of a finished cross-play, whose best robot with a partner may be its best
            response.
        on_progress: Told how far the run is.

    Raises:
        ValueError: Something asked for does not exist or does not fit the task.
        ZooError: The registry cannot give what was asked for.
    """
    from evaluation.summary import save_evaluation

    if not policies:
        raise ValueError("no policy given; name at least one, for example --policy zoo:TEAM/robot")
    check_folder(folder)
    pairs = None if crossplay is None else _crossplay_pairs(crossplay, settings.task)
    manifest, chosen = choose_partners(registry, settings.task, split, partners)
    egos = _read_egos(registry, policies, settings.task)
    env, job = _make_job(registry, egos, chosen, settings, manifest)
    result, origin = _run(env, job, settings, folder, on_progress)
    summary = save_evaluation(
        folder, result.table, split=manifest, release=manifest.release, **origin
    )
    summary["notes"] = [*summary["notes"], *_own_partner_notes(egos, chosen)]
    summary |= {"lock": registry.lock, "references": None, "relative": None}
    if references is not None:
        summary |= _with_references(
            registry, env, job, chosen, settings, references, folder, pairs, on_progress
        )
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    return summary


def choose_partners(
    registry: Registry, task: str, split: str | None, patterns: str | Sequence[str] | None
) -> tuple[Split, list[PolicyEntry]]:
    """Return the split that `--split` names, and the humans of its sides, or those of them that match `--partners`.

    The default split is that of the release that the matching partners are of, if they are of one,
    else of the newest.
    """
    text = split or ("test" if patterns is None else "both")
    name, side = (
        (None, text)
        if text in SIDE_WORDS
        else (text.partition(":")[0], text.partition(":")[2] or "test")
    )
    if side not in SIDE_WORDS:
        raise ValueError(f"split is {text!r}; after the colon {', '.join(SIDE_WORDS)} are allowed")
    humans = registry.select(patterns, task=task, role="human")
    releases = {entry.release for entry in humans}
    manifest = registry.split(task, name, release=releases.pop() if len(releases) == 1 else None)
    chosen = [entry for entry in humans if manifest.side(entry.team) in SIDE_WORDS[side]]
    if not chosen:
        raise ValueError(
            f"none of the {len(humans)} partners that match is on the "
            f"{' or '.join(SIDE_WORDS[side])} side of split {manifest.id}; choose others, --split "
            "both, or another split's id (assistax-zoo split list)"
        )
    return manifest, chosen


def cross_play(
    registry: Registry,
    egos: str | Sequence[str],
    partners: str | Sequence[str],
    settings: Settings,
    folder: Path,
    *,
    release: str | None = None,
    block: tuple[int, int] | None = None,
    cluster: RayCluster | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> dict[str, Any]:
    """Evaluate the robots of a population with its humans; return what `crossplay --json` prints.

    `egos` and `partners` are globs over policy or team ids of a release, the registry's default if
    not given; a glob that names a release is taken at its word. The rest is as in
    `evaluate_policies`. With `block` only that share of the chunks is simulated, and how many are
    missing is returned: see `evaluation.evaluator.run_block`. With a `cluster` the chunks are
    spread over it, in as many blocks as it runs at once.
    """
    from evaluation.egos import registry_groups
    from evaluation.summary import save_crossplay

    check_folder(folder)
    release = release or registry.release
    try:
        manifest = registry.split(settings.task, release=release)
    except SplitError:
        manifest = None  # a population without a split has cross-play all the same
    robots = in_release(registry, egos, release, task=settings.task, role="robot")
    humans = in_release(registry, partners, release, task=settings.task, role="human")
    check_env_version(registry, robots)
    groups = registry_groups(registry, robots)
    env, job = _make_job(registry, groups, humans, settings, manifest)
    if block is not None:
        done = run_block(
            env, job, folder, block, max_envs=settings.max_envs, on_progress=on_progress
        )
        return {"block": f"{block[0]}/{block[1]}", **dataclasses.asdict(done)}
    if cluster is not None:
        make_env = partial(type(env), settings.task, env.backend)
        run_blocks_on_ray(
            make_env, job, folder, cluster, max_envs=settings.max_envs, on_progress=on_progress
        )
    result, origin = _run(env, job, settings, folder, on_progress)
    releases = ", ".join(sorted({entry.release for entry in (*robots, *humans)}))
    summary = save_crossplay(folder, result.table, split=manifest, release=releases, **origin)
    summary["lock"] = registry.lock
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    _draw(folder, summary)
    return summary


def _draw(folder: Path, summary: dict[str, Any]) -> None:
    """Draw the matrix as it was saved."""
    from evaluation.plots.heatmap import crossplay_heatmap
    from evaluation.plots.matrix import arrange
    from evaluation.plots.style import save_figure

    matrix = arrange(
        tables.read_parquet(folder / tables.PAIRS_FILE),
        tables.read_json(folder / tables.ORDER_FILE),
    )
    save_figure(crossplay_heatmap(matrix, summary), folder / FIGURE_FILE)


def in_release(
    registry: Registry, patterns: str | Sequence[str], release: str, *, task: str, role: str
) -> list[PolicyEntry]:
    """Return the policies of a release that match; a pattern that names a release is looked up in all."""
    found: dict[str, PolicyEntry] = {}
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        named = re.search(r"-v\d+(/|$)", pattern)
        chosen = registry.select(pattern, task=task, role=role, release=None if named else release)
        found |= {entry.id: entry for entry in chosen}
    return [entry for entry in registry.policies if entry.id in found]


def check_env_version(registry: Registry, entries: Sequence[PolicyEntry]) -> None:
    """Refuse policies of a release whose environment is not the installed version."""
    for entry in entries:
        trained = registry.env_version(entry)
        if trained != VERSIONS[entry.task]:
            releases = registry.data.releases.items()
            fitting = [
                name
                for name, each in releases
                if each.environments.get(entry.task) == VERSIONS[entry.task]
            ]
            raise RegistryVersionError(
                f"policy {entry.id}",
                expected=f"version {VERSIONS[entry.task]} of environment {entry.task}, as installed",
                found=f"release {entry.release}, trained on version {trained}",
                done="nothing was evaluated",
                next_step=f"choose policies of a release of this version (here {listing(fitting)}), or install the "
                f"assistax-zoo of release {entry.release}",
            )


def _with_references(
    registry: Registry,
    env: "Env",
    job: Job,
    partners: Sequence[PolicyEntry],
    settings: Settings,
    kept: Path,
    folder: Path,
    pairs: pl.DataFrame | None,
    on_progress: Callable[[Progress], None] | None,
) -> dict[str, Any]:
    """Play the reference egos, keep their episodes and bounds beside the evaluation, and return the figures."""
    from evaluation.references import bounds_table, play_references, summarise_references

    own = _own_robots(registry, partners)
    played = play_references(
        env, job, own, kept, max_envs=settings.max_envs, on_progress=on_progress
    )
    bounds = bounds_table(played, pairs)
    tables.write_parquet(played, folder / tables.REFERENCES_FILE)
    tables.write_parquet(bounds, folder / tables.BOUNDS_FILE)
    return summarise_references(tables.read_episodes(folder / tables.EPISODES_FILE), played, bounds)


def _own_robots(registry: Registry, partners: Sequence[PolicyEntry]) -> list[tuple[Group, Group]]:
    """Return robots beside the humans they were trained with, as groups of one spec each, row by row."""
    from evaluation.egos import registry_groups

    robots = {entry.team: entry for entry in registry.policies if entry.role == "robot"}
    pairs = [(robots[human.team], human) for human in partners if human.team in robots]
    specs = dict.fromkeys((robot.spec, human.spec) for robot, human in pairs)
    own = []
    for spec in specs:
        alike = [pair for pair in pairs if (pair[0].spec, pair[1].spec) == spec]
        (robot,), (human,) = (
            registry_groups(registry, [pair[seat] for pair in alike]) for seat in (0, 1)
        )
        own.append((robot, human))
    return own


def _crossplay_pairs(folder: Path, task: str) -> pl.DataFrame:
    """Read the pairs of a finished cross-play of this task and environment version."""
    summary = tables.read_json(folder / tables.SUMMARY_FILE)
    found = summary.get("task"), summary.get("env_version")
    if found != (task, VERSIONS[task]):
        raise ValueError(
            f"{folder} is of task {found[0]}, environment version {found[1]}; --crossplay needs a "
            f"cross-play of {task}, version {VERSIONS[task]}"
        )
    return tables.read_parquet(folder / tables.PAIRS_FILE)


def _make_job(
    registry: Registry,
    egos: tuple[Ego, ...],
    partners: Sequence[PolicyEntry],
    settings: Settings,
    split: Split | None,
) -> "tuple[Env, Job]":
    """Return the environment and the job of egos with partners."""
    from assistax_envs import make
    from evaluation.egos import registry_groups

    check_env_version(registry, partners)
    groups = registry_groups(registry, partners)
    env = make(settings.task, backend=settings.backend)
    job = Job(
        task=settings.task,
        env_version=env.version,
        backend=env.backend,
        egos=egos,
        partners=groups,
        episodes=settings.episodes,
        seed=settings.seed,
        stochastic=settings.stochastic,
        sides={entry.id: side for entry in partners if split and (side := split.side(entry.team))},
    )
    return env, job


def _run(
    env: "Env",
    job: Job,
    settings: Settings,
    folder: Path,
    on_progress: Callable[[Progress], None] | None,
) -> tuple[Evaluation, dict[str, Any]]:
    """Run the job, and return with it what a summary says of its origin."""
    result = run_job(env, job, folder, max_envs=settings.max_envs, on_progress=on_progress)
    return result, {
        "task": settings.task,
        "env_version": env.version,
        "backend": env.backend,
        "env_steps_per_second": result.env_steps_per_second,
    }


def _read_egos(registry: Registry, policies: Sequence[Any], task: str) -> tuple[Ego, ...]:
    from evaluation.egos import read_egos

    egos = read_egos(policies, registry, task)
    known = {entry.id: entry for entry in registry.policies}
    check_env_version(
        registry, [known[m.id] for group in egos for m in group.members if m.id in known]
    )
    return egos


def _own_partner_notes(egos: Sequence[Ego], partners: Sequence[PolicyEntry]) -> list[str]:
    """Say which partners are not new to the robots: M_test is about partners that a robot never met."""
    teams = {member.team for group in egos for member in group.members}
    own = [entry.id for entry in partners if entry.team in teams]
    return [f"trained with one of the egos, hence not new to it: {', '.join(own)}"] if own else []
