"""M_test of robots: their returns with partners that are new to them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluation.cast.cast import Cast
from evaluation.cast.egos import probe_egos, read_egos
from evaluation.cast.met_partners import check_new
from evaluation.figures.normalised import bounds_table
from evaluation.figures.saved_tables import save_evaluation
from evaluation.figures.summary import EvaluationSummary
from evaluation.play.baselines import play_references, reference_jobs
from evaluation.play.evaluator import check_folder, clear_results, run_job
from evaluation.play.how import PlaySettings
from evaluation.play.jobs import Job
from evaluation.play.progress import OnProgress, staged
from evaluation.play.robot_checks import check_distinct, describe_robots, robot_notes
from evaluation.play.runner import share_cores
from evaluation.play.study import context_of, locked_if_current, make_job, read_best_responses, seal
from evaluation.record import tables
from evaluation.record.record import Record
from population.views import View
from zoo.locations import CACHE_VARIABLE
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split

if TYPE_CHECKING:
    from assistax_envs import Env


def cast_robots(
    registry: Registry,
    robots: Sequence[Any],
    partners: tuple[Split, Sequence[PolicyEntry]],
    *,
    trained_with: str | Sequence[str] | None = None,
    baselines: bool = False,
    default: bool = False,
) -> Cast:
    """Return the cast of robots, seeds of one method, and the partners of a split.

    Robots that are told all numbers of a person play the split of the persons alone, unless teams
    were asked for.

    Args:
        registry: The published partners.
        robots: The robots, see `evaluation.cast.egos.read_egos`.
        partners: The result of `evaluation.cast.cast.choose_partners`.
        trained_with: The robots' training partners, see `zoo.met.claims.declared_met`.
        baselines: Whether baselines will be played.
        default: Whether the partners are those that play if none are asked for.

    Raises:
        ValueError: A policy does not exist or does not fit the task, or one robot is given under
            two names.
        ZooError: The registry lacks a policy, or policies do not fit together.
    """
    share_cores()
    if not robots:
        raise ValueError("no policy given; name at least one, such as zoo:TEAM/robot")
    split, humans = partners
    egos = read_egos(robots, registry, split.task)
    check_distinct(egos)
    source = registry.source_of_split(split)
    if (alone := source.alone(split)) is not split and egos.view is View.NUMBERS:
        persons = [human for human in humans if source.owns(human.team)]
        if default or len(persons) == len(humans):
            split, humans = alone, persons
    return Cast.of(
        registry,
        task=split.task,
        robots=egos,
        humans=humans,
        split=split,
        trained_with=trained_with,
        baselines=baselines,
    )


def evaluate(
    cast: Cast,
    how: PlaySettings,
    folder: Path,
    *,
    include_own: bool = False,
    references: Path | None = None,
    crossplay: Path | None = None,
    reuse: bool = False,
    replace: bool = False,
    on_progress: OnProgress = None,
) -> EvaluationSummary:
    """Play robots with the partners of a split, write the results, and return the summary.

    Args:
        cast: Robots and partners, see `cast_robots`.
        how: Settings of play.
        folder: The folder of the results. A stopped run is continued; another job is refused.
        include_own: Whether figures count partners that were trained with one of the robots.
        references: Cache of the episodes of reference egos, see `evaluation.play.baselines`. If it
            is None, no references are played.
        crossplay: Finished cross-play, whose best robots may be the partners' best responses.
        reuse: See `evaluation.play.evaluator.run_job`.
        replace: Whether to remove a job that the folder has, with its results.
        on_progress: Called with the progress of the run.

    Raises:
        ValueError: A setting does not fit the task, or the folder has another job.
        EgoError: A robot failed.
    """
    if reuse and replace:
        raise ValueError("reuse takes what the folder holds, replace removes it; choose one")
    check_folder(folder)
    if references is not None:
        advice = f"choose another cache with ${CACHE_VARIABLE}, or leave reference egos out"
        check_folder(references, advice)
    check_new(cast.sides, cast.met.left_out(cast.sides), include_own)
    env, job, split = _job(cast, how, references is not None)
    pairs = None if crossplay is None else read_best_responses(crossplay, job)
    playing: dict[str, Any] = {"max_envs": how.max_envs, "on_progress": on_progress}
    if replace:
        clear_results(env, job, folder)
    stages = 1 + (0 if references is None else len(reference_jobs(env, job, cast.own_robots)))
    shown = staged(on_progress, 1, stages, "robots with humans")
    result = run_job(env, job, folder, reuse=reuse, max_envs=how.max_envs, on_progress=shown)
    baselines, files = None, _crossplay_files(crossplay)
    if references is not None:
        episodes, kept = play_references(env, job, cast.own_robots, references, **playing)
        baselines, files = (episodes, bounds_table(episodes, pairs)), files + kept
    context = context_of(
        job, result, split=split, groups=cast.groups, release=split.release, lock=cast.lock
    )
    about = describe_robots(folder, cast.robots, env.observation_size["robot"])
    saving: dict[str, Any] = {"include_own": include_own, "references": baselines}
    saving |= {"notes": robot_notes(about, cast.robots), "metrics": job.metrics}
    with locked_if_current(job, folder):
        record = Record(result.table, folder)
        summary = save_evaluation(record, context, met=cast.met, **saving)
        seal(folder, cast, files, about)
    return summary


def _job(cast: Cast, how: PlaySettings, baselines: bool) -> "tuple[Env, Job, Split]":
    """Return the environment, the job, and the split that it is of; robots from outside answer."""
    if cast.split is None or (baselines and not cast.baselines):
        raise ValueError("the cast has no split, or no baselines; make it with `cast_robots`")
    if cast.robots.view is not View.PLAIN and baselines:
        raise ValueError(
            "robots are told secrets of the humans, references are not: leave references out"
        )
    env, job = make_job(how, cast.robots, cast.humans, cast.sides, cast.version)
    probe_egos(cast.robots, cast.task, env.observation_size["robot"], env.action_size["robot"])
    if cast.split.preferences and how.preferences is None:
        job = job.with_side_preferences(cast.split.preferences)
    return env, job, cast.split


def _crossplay_files(crossplay: Path | None) -> list[Path]:
    """Return the files of a cross-play that figures use; empty if there is no cross-play."""
    if crossplay is None:
        return []
    return [crossplay / name for name in (tables.SUMMARY_FILE, tables.PAIRS_FILE)]
