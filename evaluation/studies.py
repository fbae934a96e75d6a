"""The two jobs that users run: M_test of a robot, and the cross-play of a population.

Here registry, job and summary meet; each study fills a folder.
"""

import contextlib
import dataclasses
import difflib
import re
from collections.abc import Collection, Generator, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from assistax_base.cluster import RayCluster
from assistax_base.errors import RegistryVersionError, SplitError, listing
from assistax_base.locks import locked
from assistax_envs.preferences import check_preferences, preferences_of
from assistax_envs.versions import TASKS, VERSIONS
from evaluation.cast.roster import Roster, paired_rosters, registry_roster
from evaluation.figures.normalised import bounds_table
from evaluation.figures.saved_tables import save_crossplay, save_evaluation
from evaluation.figures.summary import Context, CrossPlaySummary, EvaluationSummary, SplitName
from evaluation.play.baselines import play_references
from evaluation.play.devices import share_cores
from evaluation.play.evaluator import Evaluation, check_folder, make_way, run_job
from evaluation.play.jobs import Job, default_episodes
from evaluation.play.runner import OnProgress
from evaluation.play.shares import BlockDone, run_block, run_blocks_on_ray
from evaluation.record import manifest as provenance
from evaluation.record import tables
from evaluation.record.manifest import describe_sources
from evaluation.record.met_partners import check_new, declare, describe_met, met_partners
from evaluation.record.record import Record
from evaluation.record.verification import check_whole
from zoo.ids import EGO
from zoo.locations import CACHE_VARIABLE
from zoo.namespaces import split_namespace
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split
from zoo.splits import SIDES, parse_split

if TYPE_CHECKING:
    from assistax_envs import Env


@dataclasses.dataclass(frozen=True)
class Settings:
    """What both jobs have in common."""

    task: str
    episodes: int | None = None  # of each pair; None is `default_episodes`
    seed: int = 0  # of the episodes: each partner has its own, the same for every robot
    backend: str = "auto"
    stochastic: bool = False  # draw actions instead of taking each policy's mode
    max_envs: int | None = None  # simulations at once; None is the backend's default
    # Of a gentle task's humans, such as "p1,p5"; None is the split's, or all of them, in turns.
    preferences: str | Sequence[str] | None = None
    series: int = 1  # episodes in which a robot remembers a partner, one after the other

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise ValueError(f"task is {self.task!r}; allowed are {', '.join(TASKS)}")
        if self.episodes is not None and self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; each pair needs at least 1")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; allowed is 0 or more")
        if self.max_envs is not None and self.max_envs < 1:
            raise ValueError(f"max_envs is {self.max_envs}; allowed is 1 or more")
        if self.preferences is not None:
            check_preferences(self.task, self.wishes)

    @property
    def wishes(self) -> tuple[str, ...]:
        """The preferences that partners play under, in turns; none for the paper's tasks."""
        if self.preferences is None:
            return preferences_of(self.task)
        named = self.preferences
        return tuple(named.split(",") if isinstance(named, str) else named)


def evaluate_policies(
    registry: Registry,
    policies: Sequence[Any],
    settings: Settings,
    folder: Path,
    *,
    split: str | None = None,
    partners: str | Sequence[str] | None = None,
    include_own: bool = False,
    trained_with: str | Sequence[str] | None = None,
    references: Path | None = None,
    crossplay: Path | None = None,
    reuse: bool = False,
    replace: bool = False,
    on_progress: OnProgress = None,
) -> EvaluationSummary:
    """Evaluate robots, seeds of one method, against the partners of a split.

    Args:
        registry: The published partners.
        policies: The robots, see `evaluation.cast.egos.read_egos`.
        settings: Task, episodes and the rest.
        folder: Filled with the episodes and their tables; a run that was stopped goes on, and
            another job is refused.
        split: "test" (default), "train" or "both" sides of the default split, or ID:SIDE.
        partners: Globs over partners, to play only some of those sides; see `choose_partners`.
        include_own: Count partners that were trained with one of the robots.
        trained_with: Whom the robots met in training, see `zoo.met.declared_met`.
        references: Folder that keeps the episodes of reference egos, see
        `evaluation.play.baselines`;
            None plays none.
        crossplay: Finished cross-play, whose best robots may be the partners' best responses.
        reuse: See `evaluation.play.evaluator.run_job`.
        replace: Remove the job that the folder holds, whichever it is, and all drawn from it.
        on_progress: Told how far the run is.

    Raises:
        ValueError: What was asked for does not exist or does not fit the task.
        ZooError: The registry cannot give it.
    """
    share_cores()
    if not policies:
        raise ValueError("no policy given; name at least one, for example --policy zoo:TEAM/robot")
    if reuse and replace:
        raise ValueError("reuse takes what the folder holds, replace removes it; choose one")
    check_folder(folder)
    if references is not None:
        advice = f"choose another cache with ${CACHE_VARIABLE}, or leave reference egos out"
        check_folder(references, f"{advice} with --no-references")
    pairs = None if crossplay is None else _crossplay_pairs(crossplay, settings.task)
    manifest, chosen = choose_partners(registry, settings.task, split, partners)
    egos = _read_egos(registry, policies, settings.task)
    egos = declare(egos, registry, settings.task, trained_with)
    met = met_partners(egos, chosen)
    sides = {entry.id: manifest.side(entry.team) for entry in chosen}
    check_new(sides, met.left_out(sides), include_own)
    env, job = make_job(registry, egos, chosen, settings, manifest)
    _probe(egos, env)
    if manifest.preferences and settings.preferences is None:
        job = job.following(manifest.preferences)
    playing: dict[str, Any] = {"max_envs": settings.max_envs, "on_progress": on_progress}
    if replace:
        make_way(env, job, folder)
    result = run_job(env, job, folder, reuse=reuse, **playing)
    played, files = None, _own_files(egos, crossplay)
    if references is not None:
        own = own_robots(registry, chosen)
        episodes, kept = play_references(env, job, own, references, **playing)
        played, files = (episodes, bounds_table(episodes, pairs)), files + kept
    context = context_of(registry, job, manifest, manifest.release, result)
    robots = set() if references is None else {entry.team for entry in chosen}
    with _still_of(job, folder):
        summary = save_evaluation(
            Record(result.table, folder),
            context,
            include_own=include_own,
            references=played,
            met=met,
        )
        _seal(registry, folder, egos, chosen, manifest, robots, files, trained_with=trained_with)
    return summary


def choose_partners(
    registry: Registry, task: str, split: str | None, patterns: str | Sequence[str] | None
) -> tuple[Split, list[PolicyEntry]]:
    """Return the split that `split` names, and the humans of its sides that match `patterns`.

    The default split is that of the release that the matching partners are of, if they are of one,
    else the task's own.
    """
    name, side = parse_split(split, registry.parts)
    humans = registry.select(patterns, task=task, role="human")
    releases = {entry.release for entry in humans}
    release = releases.pop() if len(releases) == 1 else None
    if name is not None:
        _check_split_name(registry, task, name)
    manifest = registry.split(task, name, release=release)
    chosen = [entry for entry in humans if manifest.side(entry.team) in SIDES[side]]
    if not chosen:
        raise ValueError(
            f"none of the {len(humans)} partners that match is on the "
            f"{' or '.join(SIDES[side])} side of split {manifest.id}; choose others, --split "
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
    replace: bool = False,
    on_progress: OnProgress = None,
) -> CrossPlaySummary | BlockDone:
    """Evaluate the robots of a population with its humans.

    `egos` and `partners` are globs over policy or team ids of a release, the task's default if not
    given; a glob that names a release is taken at its word. The rest is as in
    `evaluate_policies`. With `block` only that share of the chunks is simulated, and how many are
    missing is returned: see `evaluation.play.shares.run_block`. With a `cluster` the chunks are
    spread over it, in as many blocks as it runs at once.
    """
    share_cores()
    check_folder(folder)
    robots = in_release(registry, egos, release, task=settings.task, role="robot")
    humans = in_release(registry, partners, release, task=settings.task, role="human")
    zoos = {split_namespace(entry.release)[0] for entry in humans}
    namespace = zoos.pop() if len(zoos) == 1 else ""
    try:
        named = _release(registry, settings.task, release, namespace)
        manifest = registry.split(settings.task, release=named)
    except SplitError:
        manifest = None  # a population without a split has cross-play all the same
    check_env_version(registry, robots)
    env, job = make_job(registry, registry_roster(registry, robots), humans, settings, manifest)
    options: dict[str, Any] = {"max_envs": settings.max_envs, "on_progress": on_progress}
    if replace:
        make_way(env, job, folder)
    if block is not None:
        return run_block(env, job, folder, block, **options)
    if cluster is not None:
        make_env = partial(type(env), settings.task, env.backend)
        run_blocks_on_ray(make_env, job, folder, cluster, **options)
    result = run_job(env, job, folder, **options)
    releases = ", ".join(sorted({entry.release for entry in (*robots, *humans)}))
    context = context_of(registry, job, manifest, releases, result)
    with _still_of(job, folder):
        met = met_partners(job.egos, humans)
        summary = save_crossplay(Record(result.table, folder), context, met)
        _draw(folder, summary)
        _seal(registry, folder, job.egos, humans, manifest)
    return summary


@contextlib.contextmanager
def _still_of(job: Job, folder: Path) -> Generator[None]:
    """Hold a folder, unless another process has replaced its job: no table joins other episodes."""

    def check() -> None:
        if (provenance.read_manifest(folder) or {}).get("job") != job.digest():
            raise ValueError(
                f"the job of {folder} was replaced while this command ran; repeat it into another "
                "folder"
            )

    check()  # before waiting for who replaced it
    with locked(folder, wait=True):
        check()
        yield


def _draw(folder: Path, summary: CrossPlaySummary) -> None:
    """Draw the matrix as it was saved."""
    from evaluation.plots.heatmap import crossplay_heatmap
    from evaluation.plots.matrix import arrange
    from evaluation.plots.style import save_figure

    matrix = arrange(
        tables.read_parquet(folder / tables.PAIRS_FILE),
        tables.read_json(folder / tables.ORDER_FILE),
    )
    figure = crossplay_heatmap(matrix, tables.to_json(summary))
    save_figure(figure, folder / tables.MATRIX_FIGURE)


def in_release(
    registry: Registry, patterns: str | Sequence[str], release: str | None, *, task: str, role: str
) -> list[PolicyEntry]:
    """Return the policies of a release that match, by default the task's of the pattern's zoo.

    A pattern that names a release is looked up in all. One that matches teams means them alone:
    egos, which have no human, are taken where nothing else matches, as in "scratch/*-ego-*".
    """
    found: dict[str, PolicyEntry] = {}
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        namespace = split_namespace(pattern)[0]
        wanted = _release(registry, task, release, namespace if namespace in registry.parts else "")
        named = re.search(r"-v\d+(/|$)", pattern)
        chosen = registry.select(pattern, task=task, role=role, release=None if named else wanted)
        teams = [entry for entry in chosen if entry.disability != EGO]
        found |= {entry.id: entry for entry in teams or chosen}
    return [entry for entry in registry.policies if entry.id in found]


def _release(registry: Registry, task: str, release: str | None, namespace: str) -> str:
    """Return the release that is meant in one zoo; the task's default one if none was named."""
    if release is None:
        return registry.release_of(task, namespace)
    return f"{namespace}:{release}" if namespace and ":" not in release else release


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
                expected=f"version {VERSIONS[entry.task]} of environment {entry.task}, as "
                "installed",
                found=f"release {entry.release}, trained on version {trained}",
                done="nothing was evaluated",
                next_step="choose policies of a release of this version (here "
                f"{listing(fitting)}), or install the assistax-zoo of release {entry.release}",
            )


def _check_split_name(registry: Registry, task: str, name: str) -> None:
    """Say that neither a side nor a split has this name, and which are near."""
    try:
        registry.split(task, name)
    except SplitError:
        ids = [one.id for one in registry.data.splits if one.task == task]
        near = difflib.get_close_matches(name, [*SIDES, *ids], n=2, cutoff=0.4)
        told = f", nearest: {', '.join(near)}" if near else ""
        raise ValueError(
            f"split {name!r} is neither a side (test, train, both) nor a split's id{told}; "
            "`assistax-zoo split list` prints the ids"
        ) from None


def _read_egos(registry: Registry, policies: Sequence[Any], task: str) -> Roster:
    from evaluation.cast.egos import read_egos

    egos = read_egos(policies, registry, task)
    check_env_version(registry, [one for one in registry.policies if one.id in egos.members])
    return egos


def _probe(egos: Roster, env: "Env") -> None:
    from evaluation.cast.egos import probe_egos

    probe_egos(egos, env.task, env.observation_size["robot"], env.action_size["robot"])


def make_job(
    registry: Registry,
    egos: Roster,
    partners: Sequence[PolicyEntry],
    settings: Settings,
    split: Split | None = None,
) -> "tuple[Env, Job]":
    """Return the environment and the job of egos with partners, on their sides of a split."""
    from assistax_envs import make

    check_env_version(registry, partners)
    humans = registry_roster(registry, partners)
    env = make(settings.task, backend=settings.backend)
    job = Job(
        task=settings.task,
        env_version=env.version,
        backend=env.backend,
        engine=getattr(env, "engine", {}),
        egos=egos,
        partners=humans,
        episodes=settings.episodes or default_episodes(settings.task, settings.series),
        seed=settings.seed,
        stochastic=settings.stochastic,
        series=settings.series,
        apart=True,
        sides={entry.id: side for entry in partners if split and (side := split.side(entry.team))},
        preferences=settings.wishes,
    )
    return env, job


def own_robots(registry: Registry, partners: Sequence[PolicyEntry]) -> tuple[Roster, Roster] | None:
    """Return robots beside the partners that were trained with them; None if none is published."""
    robots = {entry.team: entry for entry in registry.policies if entry.role == "robot"}
    pairs = [(robots[human.team], human) for human in partners if human.team in robots]
    return paired_rosters(registry, pairs) if pairs else None


def _own_files(egos: Roster, crossplay: Path | None) -> list[Path]:
    """Return the files that figures are drawn from beside the registry's and references'."""
    files = [path for member in egos.members.values() for path in member.files]
    if crossplay is not None:
        files += [crossplay / name for name in (tables.SUMMARY_FILE, tables.PAIRS_FILE)]
    return files


def context_of(
    registry: Registry, job: Job, split: Split | None, release: str, result: Evaluation
) -> Context:
    """Return what the table does not say of its run."""
    return Context(
        task=job.task,
        env_version=job.env_version,
        backend=job.backend,
        engine=dict(job.engine),
        release=release,
        split=SplitName(split.id, split.sha256, dict(split.preferences)) if split else None,
        lock=registry.lock,
        env_steps_per_second=result.env_steps_per_second,
    )


def _seal(
    registry: Registry,
    folder: Path,
    egos: Roster,
    partners: Sequence[PolicyEntry],
    split: Split | None,
    own_robots_of: Collection[str] = (),
    files: Iterable[Path] = (),
    trained_with: str | Sequence[str] | None = None,
) -> None:
    """Write the hashes of all files, of what they were drawn from, and the releases' roots."""
    names = {*egos.members, *(entry.id for entry in partners)}
    entries = [
        entry
        for entry in registry.policies
        if entry.id in names or (entry.role == "robot" and entry.team in own_robots_of)
    ]
    roots = {release: registry.root(release) for release in sorted({e.release for e in entries})}
    provenance.seal(
        folder,
        registry={"roots": roots, "lock": registry.lock},
        met=describe_met(egos, trained_with),
        sources=describe_sources(registry, entries, split.id if split else None, files),
    )


def _crossplay_pairs(folder: Path, task: str) -> pl.DataFrame:
    """Read the pairs of a finished cross-play of this task and environment version."""
    check_whole(folder)
    summary = tables.read_json(folder / tables.SUMMARY_FILE)
    found = summary.get("task"), summary.get("env_version")
    if found != (task, VERSIONS[task]):
        raise ValueError(
            f"{folder} is of task {found[0]}, environment version {found[1]}; --crossplay needs a "
            f"cross-play of {task}, version {VERSIONS[task]}"
        )
    return tables.read_parquet(folder / tables.PAIRS_FILE)
