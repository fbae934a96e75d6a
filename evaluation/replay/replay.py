"""Replay a finished, untrusted folder, to check that it holds the results of its job.

No figure relies on the folder's manifest. The job is made again from the registry, every table and
figure is computed again from the episodes, and a sample of the episodes is played again. Whole
tiles are played, so that each episode is in the same row of the same program.

Values that are equal to the last bit pass. Other values fail if the folder names this kind of
machine. If it names another one, they must be within the measured differences of processors, see
`evaluation.replay.noise`. A forger may name any machine, so the report has the largest bias of the
headline figure that would pass, see `evaluation.replay.headline`.
"""

import contextlib
import dataclasses
import secrets
from collections.abc import Generator, Mapping, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from evaluation.cast.cast import own_robots
from evaluation.figures.normalised import COLUMN
from evaluation.play.baselines import reference_jobs, with_names
from evaluation.play.jobs import Job
from evaluation.play.robot_checks import robot_notes, varying
from evaluation.play.runner import Runner
from evaluation.play.study import read_best_responses
from evaluation.play.tiles import Chunk, Tile, cut_tiles
from evaluation.record import tables
from evaluation.record.manifest import processor
from evaluation.record.record import Record
from evaluation.record.verification import verify_folder
from evaluation.replay import rederive
from evaluation.replay.headline import Headline, Reach, Verdict, hidden_share, verdict_of
from evaluation.replay.job import RebuiltJob, rebuild_job, source_problems
from evaluation.replay.noise import differing_rows, hidden_bias, noise_problems
from zoo.lock import apply_lock, read_lock
from zoo.registry import Registry

DETERMINISTIC = ("native", "fused")  # backends that, on one kind of CPU, always give the same bits
KEYS = ["ego", "partner", "episode"]
NOT_ITS_JOB = "not what its job gives, or another version of assistax-zoo drew its figures"


@dataclasses.dataclass(frozen=True)
class ReplayReport:
    """Result of replaying a sample of a folder's episodes."""

    folder: str
    episodes: int  # number of replayed episodes of the job
    exact: bool  # whether values were compared bit by bit
    why: str  # the reason for `exact`
    differing: int  # number of replayed episodes with a differing value
    ok: bool  # whether there are no problems
    verdict: Verdict = "differs"
    figure: str = ""  # name of the headline figure
    value: float = 0.0  # the headline figure in the folder
    # Mean of the headline figure's replayed episodes, minus their mean in the folder.
    difference: float | None = None
    # Largest bias of that mean that would pass; None if no such episode was replayed.
    hidden: float | None = None
    hidden_share: float | None = None  # `hidden` divided by the figure
    # The same bias for success and violation, as a share of episodes.
    hidden_flags: Mapping[str, float] = dataclasses.field(default_factory=dict)
    tiles: int = 0  # number of replayed tiles of the job
    of_tiles: int = 0  # number of all tiles of the job
    found: float = 0.0  # chance that one changed tile is among the replayed ones
    seed: int = 0  # of the sample
    of_episodes: int = 0  # number of the job's episodes in the folder
    references: int = 0  # number of replayed episodes of the reference egos
    of_references: int = 0  # number of all episodes of the reference egos
    problems: tuple[str, ...] = ()
    unchecked: tuple[str, ...] = ()  # claims of the folder that this check cannot confirm


def replay_folder(
    folder: Path,
    registry: Registry,
    *,
    sample: int = 20,
    seed: int | None = None,
    run_code: bool = False,
    lock: Path | None = None,
    crossplay: Path | None = None,
) -> ReplayReport:
    """Return the report on a folder: figures computed again, a sample of episodes played again.

    Args:
        folder: A folder of an evaluation or a cross-play, not trusted.
        registry: The registry of its partners, and of its robots if they are published.
        sample: Least number of replayed episodes, of the job and of each of its references. Whole
            tiles are played.
        seed: Seed of the choice of tiles; by default an unpredictable one.
        run_code: Whether to run robots of Python code that the folder names: trust it first.
        lock: File of the lock under which the folder was made.
        crossplay: Folder of the cross-play whose robots are best responses, which is checked too.

    Raises:
        ValueError: The folder was changed, or its job cannot be played here.
    """
    if sample < 1:
        raise ValueError(f"sample is {sample}; give at least 1")
    if problems := verify_folder(folder).problems:
        raise ValueError(f"{problems[0]}; a folder that was changed is not replayed")
    seed = secrets.randbits(32) if seed is None else seed
    record = Record.read(folder)
    with _strange_manifest_refused(folder):
        if lock:
            task = str(record.manifest["identity"]["task"])
            registry = apply_lock(registry, read_lock(lock), task=task)
        rebuilt = rebuild_job(record, registry, run_code=run_code)
        parts = _kept_parts(record, registry, rebuilt)
    pairs, inner = None, None
    if crossplay:
        inner = replay_folder(crossplay, registry, sample=sample, seed=seed)
        pairs = read_best_responses(crossplay, rebuilt.job)
    problems, unchecked = _written_problems(record, registry, rebuilt, parts, pairs)
    report = ReplayReport(
        *(str(folder), 0, False, NOT_ITS_JOB, 0, False),
        figure=rebuilt.headline.name,
        value=rebuilt.headline.value,
        seed=seed,
        of_episodes=parts[0].kept.height,
        of_references=sum(part.kept.height for part in parts[1:]),
        of_tiles=len(parts[0].tiles),
        problems=(*(inner.problems if inner else ()), *problems),
        unchecked=(*unchecked, *_crossplay_notes(inner)),
    )
    if report.problems:
        return report
    chosen = _choose(parts, sample, seed)
    played = [_play(rebuilt.env, *row) for row in zip(parts, chosen, strict=True)]
    report = dataclasses.replace(report, tiles=len(chosen[0]))
    return _judge(report, record.manifest, rebuilt, parts, played)


@contextlib.contextmanager
def _strange_manifest_refused(folder: Path) -> Generator[None]:
    """Turn errors of a manifest's malformed fields in a `with` block into a ValueError."""
    try:
        yield
    except (KeyError, TypeError, IndexError, AttributeError, OverflowError) as error:
        raise ValueError(f"the manifest of {folder} names no job: {error!r}") from error


def _missing_notes(manifest: Mapping[str, Any], rebuilt: RebuiltJob) -> list[str]:
    """Return notes on robots from outside that hold here and that the folder lacks."""
    egos = rebuilt.job.egos
    found = varying(egos, rebuilt.env.observation_size["robot"])
    recorded = robot_notes(manifest.get("robots"), egos)
    expected = robot_notes({"varies": found}, egos)
    return [f"what the folder does not say: {note}" for note in expected if note not in recorded]


@dataclasses.dataclass(frozen=True)
class _Part:
    """A job of a folder, with its tiles, planned columns, and episodes in the folder."""

    job: Job
    tiles: Sequence[Tile]
    planned: pl.DataFrame
    kept: pl.DataFrame


def _kept_parts(record: Record, registry: Registry, rebuilt: RebuiltJob) -> list[_Part]:
    """Return the parts of a folder: its own job, then the jobs of its references."""
    jobs, kept = [rebuilt.job], [record.table]
    if (references := rederive.read_references(record.folder)) is not None:
        own = own_robots(registry, rebuilt.partners)
        jobs += reference_jobs(rebuilt.env, rebuilt.job, own)
    cut = [cut_tiles(job, rebuilt.tile_envs) for job in jobs]
    planned = [rederive.planned_table(job, tiles) for job, tiles in zip(jobs, cut, strict=True)]
    if references is not None:
        ends = np.cumsum([table.height for table in planned[1:]])
        if references.height != ends[-1]:
            raise ValueError(
                f"{record.folder / tables.REFERENCES_FILE} has {references.height} episodes; "
                f"the job's references have {ends[-1]}"
            )
        kept += [
            references.slice(end - table.height, table.height)
            for end, table in zip(ends, planned[1:], strict=True)
        ]
        planned[1:] = [with_names(table) for table in planned[1:]]
    rows = zip(jobs, cut, planned, kept, strict=True)
    return [_Part(*row) for row in rows]


def _written_problems(
    record: Record,
    registry: Registry,
    rebuilt: RebuiltJob,
    parts: Sequence[_Part],
    pairs: pl.DataFrame | None,
) -> tuple[list[str], tuple[str, ...]]:
    """Return problems of manifest, planned columns and figures, and the unchecked claims."""
    has_references = len(parts) > 1
    is_crossplay = (record.folder / tables.PAIRS_FILE).is_file()
    problems, unchecked = source_problems(record.manifest, registry, rebuilt, has_references)
    names = [tables.EPISODES_FILE, *[tables.REFERENCES_FILE] * (len(parts) - 1)]
    for part, name in zip(parts, names, strict=True):
        problems += rederive.planned_problems(part.kept, part.planned, name)
    if not problems:
        rederive.check_crossplay(record.folder, pairs)
        references = pl.concat([part.kept for part in parts[1:]]) if has_references else None
        problems = rederive.derived_problems(
            record,
            rebuilt.context,
            rebuilt.met,
            is_crossplay=is_crossplay,
            references=references,
            crossplay=pairs,
            notes=robot_notes(record.manifest.get("robots"), rebuilt.job.egos),
            metrics=rebuilt.metrics,
        )
    picture = [f"{tables.MATRIX_FIGURE}, a picture"] * is_crossplay
    unsaid = _missing_notes(record.manifest, rebuilt)
    return problems, (*rebuilt.unchecked, *unchecked, *picture, *unsaid)


def _crossplay_notes(inner: ReplayReport | None) -> list[str]:
    """Return a note if the cross-play of best responses is not confirmed to the last bit."""
    if inner is None or inner.verdict in ("same", "differs"):
        return []
    return [f"best responses, of a cross-play whose verdict is {inner.verdict!r}: {inner.why}"]


def _choose(parts: Sequence[_Part], sample: int, seed: int) -> list[list[Tile]]:
    """Return random tiles of each part, with at least `sample` episodes if it has so many."""
    rng, chosen = np.random.default_rng(seed), [[] for _ in parts]
    for part, tiles in zip(parts, chosen, strict=True):
        for place in rng.permutation(len(part.tiles)):
            tiles.append(part.tiles[place])
            if sum(tile.rows for tile in tiles) >= sample:
                break
    return chosen


def _play(env: Any, part: _Part, chosen: Sequence[Tile]) -> pl.DataFrame:
    """Return the episodes of tiles of a part, played again and sorted by `KEYS`."""
    rows: list[pl.DataFrame] = []
    chunks = [Chunk(index, (tile,)) for index, tile in enumerate(chosen)]
    Runner(env, part.job).run(chunks, lambda _, played: rows.append(played))
    again = pl.concat(rows).sort(KEYS)
    return with_names(again) if COLUMN in part.kept.columns else again


def _judge(
    report: ReplayReport,
    manifest: Mapping[str, Any],
    rebuilt: RebuiltJob,
    parts: Sequence[_Part],
    played: Sequence[pl.DataFrame],
) -> ReplayReport:
    """Return the report with problems and verdict, from the replayed and the folder's episodes."""
    kept = [
        rebuilt.metrics.without_absent(part.kept).join(again, on=KEYS, how="semi").sort(KEYS)
        for part, again in zip(parts, played, strict=True)
    ]
    pairs = list(zip(kept, played, strict=True))
    if strange := [
        name for old, new in pairs for name in sorted(dict(old.schema.items() ^ new.schema.items()))
    ]:
        problem = f"the columns {', '.join(strange)} are not those of the job's episodes"
        return dataclasses.replace(report, why="other columns", problems=(problem,))
    differing = sum(int(differing_rows(old, new).sum()) for old, new in pairs)
    same_machine, why = _same_machine(manifest, rebuilt.job)
    exact, task = differing == 0 or same_machine, rebuilt.job.task
    problems: list[str] = []
    unmeasured = () if exact else rebuilt.metrics.noise_notes(parts[0].kept)
    if exact and differing:
        problems = [f"{differing} episodes played again have other values"]
    elif differing:
        problems += noise_problems(task, *pairs[0], *rebuilt.headline.means)
        problems += [text for pair in pairs[1:] for text in noise_problems(task, *pair)]
    report = dataclasses.replace(
        report,
        episodes=kept[0].height,
        references=sum(table.height for table in kept[1:]),
        exact=exact,
        why=why if differing or same_machine else f"the same bits, though {why}",
        differing=differing,
        problems=tuple(problems),
        unchecked=(*report.unchecked, *unmeasured),
        ok=not problems,
    )
    return _with_verdict(report, rebuilt.headline, parts[0].kept, pairs[0], task)


def _with_verdict(
    report: ReplayReport,
    headline: Headline,
    whole: pl.DataFrame,
    pair: tuple[pl.DataFrame, pl.DataFrame],
    task: str,
) -> ReplayReport:
    """Return the report with the verdict and the bias that the headline figure could hide."""
    kept, found = (table.filter(headline.rows)["return"].cast(pl.Float64) for table in pair)
    same = report.exact and not kept.is_empty()
    reach = Reach(
        report.tiles,
        report.of_tiles,
        whole.filter(headline.rows).height - kept.len(),
        0.0 if same else headline.mean_bias(partial(hidden_bias, task, pair[1])),
        None if kept.is_empty() else float(np.mean((found - kept).to_numpy())),
    )
    flags = [name for name in ("success", "violated") if name in whole.columns]
    biases = (
        {}
        if report.exact
        else {
            name: headline.mean_bias(partial(hidden_bias, task, pair[1], name=name))
            for name in flags
        }
    )
    return dataclasses.replace(
        report,
        verdict=verdict_of(headline, reach, same_bits=report.exact) if report.ok else "differs",
        difference=reach.difference,
        hidden=reach.hidden,
        hidden_share=hidden_share(headline, reach),
        hidden_flags={name: bias for name, bias in biases.items() if bias is not None},
        found=reach.found,
    )


def _same_machine(manifest: Mapping[str, Any], job: Job) -> tuple[bool, str]:
    """Return whether the folder names this kind of machine, with exact results, and the reason."""
    made, identity = _as_object(manifest.get("made_with")), manifest["identity"]
    pairs = {
        "processor": (made.get("processor"), processor()),
        "jaxlib": (_as_object(made.get("versions")).get("jaxlib"), version("jaxlib")),
        "engine": (identity["engine"], dict(job.engine)),
        "software": (identity["software"], job.identity()["software"]),
    }
    differing = [name for name, (recorded, here) in pairs.items() if recorded != here]
    if differing:
        return False, f"other {', '.join(differing)} than where it was made, as the folder says"
    if job.backend not in DETERMINISTIC:
        return False, f"{job.backend} rounds differently from run to run"
    return True, "same processor, jaxlib and engine, as the folder says"


def _as_object(value: Any) -> dict[str, Any]:
    """Return a manifest's value if it is an object, else an empty dict."""
    return value if isinstance(value, dict) else {}
