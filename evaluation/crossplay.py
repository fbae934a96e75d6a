"""The cross-play of a population: every robot with every human."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from assistax_base.cluster import RayCluster
from assistax_base.errors import SplitError
from evaluation.cast.cast import Cast, in_release, release_in
from evaluation.cast.roster import registry_roster
from evaluation.figures.saved_tables import save_crossplay
from evaluation.figures.summary import CrossPlaySummary
from evaluation.play.evaluator import check_folder, clear_results, run_job
from evaluation.play.how import PlaySettings
from evaluation.play.progress import OnProgress
from evaluation.play.runner import share_cores
from evaluation.play.shares import run_blocks_on_ray
from evaluation.play.study import context_of, locked_if_current, make_job, seal
from evaluation.record import tables
from evaluation.record.record import Record
from zoo.namespaces import split_namespace
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split


def cast_population(
    registry: Registry,
    task: str,
    robots: str | Sequence[str],
    humans: str | Sequence[str] | None,
    release: str | None = None,
    persons: int | None = None,
) -> Cast:
    """Return the cast of a population: robots and humans by globs over policy or team ids.

    They are of `release`, by default the task's, unless a glob names a release. Humans may also be
    "persons", at most `persons` of the test side. If `humans` is None, all humans are cast, or
    persons if the release has no other humans of the task.

    Raises:
        ZooError: The registry lacks a policy, or policies do not fit together.
    """
    share_cores()
    egos = in_release(registry, robots, release, task=task, role="robot")
    dealt = None if humans else _split(registry, task, (), release)
    source = registry.source_asked(None, humans)
    if source is None and dealt is not None:
        source = registry.source_of_split(dealt)
        source = None if source.teams_of(dealt) else source
    if source and source.word:  # others than teams
        split, partners = source.choose(task, None, humans or source.word, persons)
    else:
        partners = in_release(registry, humans or f"{task}/*", release, task=task, role="human")
        split = _split(registry, task, partners, release)
    return Cast.of(
        registry,
        task=task,
        robots=registry_roster(registry, egos),
        humans=partners,
        split=split,
    )


def cross_play(
    cast: Cast,
    how: PlaySettings,
    folder: Path,
    *,
    cluster: RayCluster | None = None,
    replace: bool = False,
    on_progress: OnProgress = None,
) -> CrossPlaySummary:
    """Play the robots of a population with its humans, write the results, return the summary.

    Args:
        cast: Robots and humans, see `cast_population`.
        how: Settings of play.
        folder: As in `evaluation.evaluate.evaluate`.
        cluster: A cluster that simulates the chunks, in as many blocks as it runs at once.
        replace: As in `evaluation.evaluate.evaluate`.
        on_progress: Called with the progress of the run.

    Raises:
        ValueError: The folder holds another job, or cannot be written.
    """
    check_folder(folder)
    env, job = make_job(how, cast.robots, cast.humans, cast.sides, cast.version)
    options: dict[str, Any] = {"max_envs": how.max_envs, "on_progress": on_progress}
    if replace:
        clear_results(env, job, folder)
    if cluster is not None:
        make_env = partial(type(env), how.task, env.backend, version=cast.version)
        run_blocks_on_ray(make_env, job, folder, cluster, **options)
    result = run_job(env, job, folder, **options)
    releases = ", ".join(cast.releases)
    context = context_of(
        job, result, split=cast.split, groups=cast.groups, release=releases, lock=cast.lock
    )
    with locked_if_current(job, folder):
        summary = save_crossplay(Record(result.table, folder), context, cast.met, job.metrics)
        _draw(folder, summary)
        seal(folder, cast)
    return summary


def _split(
    registry: Registry, task: str, humans: Sequence[PolicyEntry], release: str | None
) -> Split | None:
    """Return the default split of the humans' release, or None if it has no split.

    For humans of several releases, it is that of the requested release, or of the task's default.
    """
    releases = {human.release for human in humans}
    if len(releases) == 1:
        [release] = releases
    else:
        zoos = {split_namespace(name)[0] for name in releases}
        release = release_in(registry, task, release, zoos.pop() if len(zoos) == 1 else "")
    try:
        return registry.split(task, release=release)
    except SplitError:
        return None


def _draw(folder: Path, summary: CrossPlaySummary) -> None:
    """Draw the matrix of the saved pairs into the folder."""
    from evaluation.plots.crossplay.heatmap import crossplay_heatmap
    from evaluation.plots.crossplay.matrix import arrange
    from evaluation.plots.style import save_figure

    matrix = arrange(tables.read_parquet(folder / tables.PAIRS_FILE))
    figure = crossplay_heatmap(matrix, tables.to_json(summary))
    save_figure(figure, folder / tables.MATRIX_FIGURE)
