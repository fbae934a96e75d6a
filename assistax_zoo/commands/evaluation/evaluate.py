"""M_test of robot policies against the zoo's partners, and the cross-play of a population."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from assistax_base.errors import counted
from assistax_zoo.commands.evaluation.shown import (
    print_crossplay,
    print_evaluation,
    print_headline,
)
from assistax_zoo.commands.options import Engine, PartnerChoice, Source
from assistax_zoo.shell.console import answer, print_json, stdout_is_data
from evaluation.play.how import PlaySettings


@dataclasses.dataclass(frozen=True)
class EvaluationSettings(PlaySettings):
    """Settings of an evaluation; the names of its robots may say its task."""

    # Its options have the same help.
    __doc__ = PlaySettings.__doc__
    task: str = ""

    def __post_init__(self) -> None:
        if self.task:
            super().__post_init__()

    def given(self) -> dict[str, Any]:
        """Return the settings as arguments of the functions of `assistax_zoo`."""
        return {**vars(self), "task": self.task or None}


@dataclasses.dataclass(frozen=True)
class CrossPlaySettings(EvaluationSettings):
    """Settings of a cross-play, which has no series."""

    __doc__ = PlaySettings.__doc__
    series: Annotated[int, Parameter(parse=False)] = 1


def evaluate(
    *robots: str,
    how: Annotated[EvaluationSettings, Parameter(name="*")] = EvaluationSettings(),
    against: PartnerChoice = PartnerChoice(),
    fetch: bool = False,
    reuse: bool = False,
    replace: bool = False,
    out: Path | None = None,
    source: Source = Source(),
    all: bool = False,
    json: bool = False,
) -> None:
    """Compute M_test: the return of a robot with partners of the zoo that it never met.

    Each partner plays under its own disability setting, in its own episodes, which are the same for
    every robot. With --out, every episode is kept there as Parquet, and a stopped run continues
    where it was.

    Args:
        robots: Robot: an id, a .safetensors or .onnx file, FILE.py with a function make,
            python:FILE.py:FACTORY or python:package.module:FACTORY. For more seeds name more, or
            quote a glob of ids or .safetensors files.
        how: Settings of the play.
        against: Choice of partners and references.
        fetch: Fetch partners and robots of the zoo that are missing here from the remote.
        reuse: Take the result in the output folder of a robot from Python code, even if its module
            does not declare its dependencies. Without this the result is refused, since the robot
            may have changed.
        replace: Remove the result in the output folder, of whichever job, and play anew. Without
            this the result of another job is refused.
        out: Folder for the tables.
        source: Source of the policies.
        all: Print all figures, by group, partner's kind and reference, instead of five lines.
        json: Print JSON.

    Example:
        assistax-zoo evaluate scratch/ppo-ego-s0 --episodes 8 --out results
    """
    with stdout_is_data():
        from assistax_zoo.evaluating import evaluate as evaluate_robots

        result = evaluate_robots(
            list(robots),
            fetch=fetch,
            reuse=reuse,
            replace=replace,
            out=out,
            **vars(against),
            **how.given(),
            **source.given(),
        )
        summary = result.to_json()
    if json:
        print_json(summary)
    else:
        (print_evaluation if all else print_headline)(summary)
        if out:
            print(f"tables in {out}: episodes.parquet has every episode")


def crossplay(
    *,
    how: Annotated[CrossPlaySettings, Parameter(name="*")] = CrossPlaySettings(),
    out: Path,
    robots: tuple[str, ...] = (),
    humans: tuple[str, ...] = (),
    persons: int | None = None,
    release: str | None = None,
    share: str | None = None,
    replace: bool = False,
    engine: Engine = Engine(),
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Play every robot of a population with every human, and draw the clustered matrix.

    A robot with the human it was trained with is self-play, the matrix's diagonal. A stopped run
    continues.

    Args:
        how: Settings of the play.
        out: Folder for the tables and the figure.
        robots: Glob over robots, such as `'scratch/ippo-*'`; repeat it for more; all if not given.
        humans: Glob over humans; repeat it for more; persons for persons; all if not given.
        persons: Number of persons to draw. Default 200.
        release: Release of robots and humans, if a glob names none. Default: the newest complete
            release that has the task.
        share: Simulate only a share, such as 2/4; once all parts are there, the command without
            --share merges them.
        replace: Remove the result in the output folder, of whichever job, and play anew. Without
            this the result of another job is refused.
        engine: Engine of the blocks.
        source: Source of the policies.
        json: Print JSON.

    Example:
        assistax-zoo crossplay --robots 'scratch/ippo-*' --humans 'scratch/ippo-*' --out xp
    """
    cluster = engine.cluster()
    part = _share(share, replace, spread=cluster is not None)
    with stdout_is_data():
        from assistax_zoo.evaluating import cross_play, play_share
        from evaluation.cast.robot_names import task_of

        where: dict[str, Any] = {"release": release, "persons": persons, **source.given()}
        if part:
            how = dataclasses.replace(how, task=how.task or task_of([*robots, *humans]))
            done = vars(play_share(part, how, out, robots, humans, **where))
            summary = {**done, "share": share}
        else:
            where |= {name: value for name, value in how.given().items() if name != "series"}
            where |= {"out": out, "cluster": cluster, "replace": replace}
            summary = cross_play(robots, humans, **where).to_json()
    if share:
        answer(json, summary, *_share_lines(summary, out))
    elif json:
        print_json(summary)
    else:
        print_crossplay(summary)
        print(f"tables and crossplay.png in {out}")


def _share(text: str | None, replace: bool, spread: bool) -> tuple[int, int] | None:
    """Return the number of a share and the count of shares of i/n; None if `text` is empty."""
    if not text:
        return None
    if spread:
        raise ValueError(
            "--share is one share of a run by hand, --engine ray spreads all of them; leave one out"
        )
    if replace:
        raise ValueError("--replace would remove the parts of the other shares; leave it out")
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ValueError(f"share is {text!r}; expected i/n with i from 1 to n, such as 2/4")
    return int(number), int(count)


def _share_lines(summary: dict[str, Any], out: Path) -> tuple[str, str]:
    parts = f"{counted(summary['chunks'], 'part')} of {out}/parts"
    next_step = "all parts are here: the same command without --share merges them"
    if missing := summary["missing"]:
        next_step = (
            f"parts not here: {missing} of {summary['all_chunks']}; gather all shares' parts"
        )
    done = f"share {summary['share']}: {counted(summary['episodes'], 'episode')} in {parts}"
    return done, next_step
