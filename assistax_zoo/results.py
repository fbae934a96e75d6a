"""Results: figures as fields, the tables they come from, and a page or a figure of them."""

import contextlib
import dataclasses
import shutil
import tempfile
import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import polars as pl

from assistax_base.errors import FormatError, shorten
from evaluation.cast.met_partners import UNKNOWN, MetSummary
from evaluation.cast.robot_names import parse_reference
from evaluation.figures.bootstrap import Estimate
from evaluation.figures.metrics import CrossPlay, ZeroShot
from evaluation.figures.normalised import References, Relative
from evaluation.figures.summary import (
    CrossPlaySummary,
    EvaluationSummary,
    MatrixFigures,
    SideFigures,
    read_summary,
)
from evaluation.record import tables
from evaluation.record.manifest import table_hashes
from zoo.partners.person_ids import OWN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FigureKind = Literal["zsc", "disability", "preference", "profile"]


class TemporaryFolder:
    """A temporary folder, removed with the last result that holds it."""

    def __init__(self) -> None:
        outer = Path(tempfile.mkdtemp(prefix="assistax-zoo-"))
        self.path = outer / "robot"  # the name that figures and reports show
        self.path.mkdir()
        weakref.finalize(self, shutil.rmtree, outer, ignore_errors=True)


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class _Result:
    """Base of the results: the figures, tables and pages of a finished folder."""

    summary: Any  # every figure, as docs/evaluation.md lists them
    notes: tuple[str, ...]  # remarks on the figures for their readers
    folder: Path  # holds the tables
    keep: TemporaryFolder | None = dataclasses.field(default=None, compare=False)
    _hashes: dict[str, str] = dataclasses.field(init=False, compare=False)  # of its tables

    def __post_init__(self) -> None:
        object.__setattr__(self, "_hashes", table_hashes(self.folder))

    @classmethod
    def of(cls, summary: Any, folder: Path, keep: TemporaryFolder | None = None) -> Self:
        """Return the result of a folder, with those figures of its summary that it has as fields.

        Args:
            summary: As `evaluation.figures.saved_tables` returns it.
            folder: Holds it and the tables.
            keep: What must live as long as the result.
        """
        names = {field.name for field in dataclasses.fields(cls)} & set(vars(summary))
        figures = {name: getattr(summary, name) for name in names}
        return cls(summary=summary, folder=folder, keep=keep, **figures)

    def _own(self, *names: str) -> Path:
        """Return the folder, if its tables are still those of this result."""
        hashes = table_hashes(self.folder)
        names = names or tuple({*self._hashes, *hashes})
        if any(hashes.get(name) != self._hashes.get(name) for name in names):
            raise ValueError(
                f"{self.folder} no longer holds this result: its tables were replaced, or written "
                "again with other options; load_result reads the new tables, and `out` gives each "
                "result its own folder"
            )
        return self.folder

    @property
    def episodes(self) -> pl.DataFrame:
        """Every episode, one row each; docs/evaluation.md lists the columns and their units."""
        return tables.read_episodes(self._own(tables.EPISODES_FILE) / tables.EPISODES_FILE)

    def to_pandas(self) -> Any:
        """Return `episodes` as a pandas.DataFrame.

        Raises:
            ImportError: pandas or pyarrow is not installed.
        """
        return self.episodes.to_pandas()

    def to_json(self) -> dict[str, Any]:
        """Return the figures as `--json` prints them."""
        return tables.to_json(self.summary)

    def report(self, path: Path | str) -> Path:
        """Write one page for a browser, .html: figures, tables, versions, hashes; return its path.

        Raises:
            ValueError: The path ends otherwise.
        """
        from evaluation.report import write_report

        write_report(self._own(), Path(path))
        return Path(path)

    def save(self, folder: Path | str) -> Path:
        """Copy everything to a new folder, which `load_result` reads; return it.

        Raises:
            FileExistsError: There is something of that name.
        """
        target = Path(folder)
        if target.exists():
            raise FileExistsError(f"{target} exists; choose another folder")
        partial = target.with_name(f".{target.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(self._own(), partial)
        return partial.rename(target)

    def _figures(self) -> dict[str, Estimate | None]:
        """Return the headline figures by name."""
        raise NotImplementedError

    def plot(self, path: Path | str, *, width: float | None = None) -> "Figure":
        """Draw the result, write it, and return the figure."""
        raise NotImplementedError

    def __repr__(self) -> str:
        parts = [f"{name} {brief(figure)}" for name, figure in self._figures().items() if figure]
        return f"{type(self).__name__}({self.summary.task}: {', '.join(parts)}{self._caveat()})"

    def _caveat(self) -> str:
        """Return the remark that follows figures of unknown provenance."""
        return ""

    def _repr_html_(self) -> str:
        from evaluation.report.page import figures_html

        figures = {name: vars(figure) for name, figure in self._figures().items() if figure}
        what = f"{self.summary.task}: return of an episode"
        with tempfile.TemporaryDirectory(prefix="assistax-zoo-") as folder:
            picture = Path(folder) / "figure.png"
            self.plot(picture, width=6.0)
            return figures_html(figures, what, self.notes, picture)


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class EvaluationResult(_Result, SideFigures, ZeroShot):
    """M_test of a robot, or of the seeds of one method; returns are sums over 1000 steps of 20 ms.

    Attributes:
        m_test: Return with partners of the test side: mean, IQM, intervals, n. Of persons it is the
            mean of the groups' means. None if no test partner played, or a group did not.
        by_group: The return with each group of test partners; empty if the side has no groups.
        m_train: The same with partners of the training side.
        m_validation: The same with partners of the validation side, by which choices are made.
        gap: `m_train` less `m_test`, where both played.
        side: The side that the other figures are of: test, else validation, else training.
        by_algorithm: The return with the partners of each algorithm.
        by_disability: The return with the partners of each disability setting; "own" of persons.
        by_preference: The return under each preference of the humans of a gentle task; else empty.
        by_place: The return in each place of a series of episodes, from "1"; empty without series.
        caring_success: Share of episodes of a gentle task that reached the goal as liked, without a
            violation or much discomfort. This and what follows is None or empty of other tasks.
        failed_persons: Share of pairs of robot and person with caring success in less than half of
            the episodes.
        discomfort: Share of felt steps with discomfort.
        violations: Share of episodes of a gentle task with a violation.
        violations_by_kind: The same of "impact", too hard, and of "pressed", too long.
        adaptation: The adaptation slope of each wish, and how near touch was to what is liked.
        touch: How people were touched, by column of the table; empty where it was not measured.
        worst_partner: The partner with the lowest mean return: `partner`, `mean` and what it is.
        references: Returns to compare with, such as the script's, if they played.
        relative: The return on the scale from zero action to best response, if references played.
        summary: Every figure, as docs/evaluation.md lists them.
        notes: What a reader has to know of the figures.
        folder: Holds the tables.

    Examples:
        >>> result  # of `evaluate`
        EvaluationResult(scratch: M_test ..., d1 ...)
        >>> result.episodes.height
        2
    """

    summary: EvaluationSummary
    references: References | None
    relative: Relative | None

    @property
    def met(self) -> MetSummary:
        """Known training partners of the robots, and partners left out of figures."""
        return self.summary.met or MetSummary(known=False, source="not known", left_out=())

    @property
    def partners(self) -> pl.DataFrame:
        """One row a partner: means over robots and episodes."""
        return tables.read_parquet(self._own(tables.PARTNERS_FILE) / tables.PARTNERS_FILE)

    def plot(
        self,
        path: Path | str,
        kind: FigureKind = "zsc",
        *,
        width: float | None = None,
        bare: bool = False,
    ) -> "Figure":
        """Draw the result, write it as .png, .pdf or .svg, and return the figure.

        Args:
            path: File to write.
            kind: "zsc" for training beside test partners, "disability" for each setting,
                "preference" for preferences of a gentle task's humans, "profile" for the share of
                pairs above each return.
            width: Inches of the figure, for a paper's column or page; letters keep their size.
            bare: Leave out title and caption.
        """
        from evaluation.plots.figures import evaluation_figure

        return evaluation_figure([self._own()], kind, Path(path), width=width, bare=bare)

    def _figures(self) -> dict[str, Estimate | None]:
        sides = {"M_test": self.m_test, "M_train": self.m_train, "M_train - M_test": self.gap}
        sides["M_validation"] = self.m_validation
        settings = {name: one for name, one in self.by_disability.items() if name != OWN}
        return {**sides, **self.by_group, **settings, **self.by_preference}

    def _caveat(self) -> str:
        return "" if self.met.known else f"; {UNKNOWN}"


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class CrossPlayResult(_Result, MatrixFigures, CrossPlay):
    """Every robot of a population with every human; returns are sums over 1000 steps of 20 ms.

    Attributes:
        self_play: Return of robots with the humans they were trained with: mean, IQM, intervals, n.
        cross_play: Return of robots with all other humans.
        gap: `self_play` less `cross_play`.
        best_ego: The robot with the highest mean return: `ego` and `mean`.
        summary: Every figure, as docs/evaluation.md lists them.
        notes: What a reader has to know of the figures.
        folder: Holds the tables.

    Examples:
        >>> matrix  # of `cross_play`
        CrossPlayResult(scratch: self-play ...)
        >>> matrix.pairs.height
        1
    """

    summary: CrossPlaySummary

    @property
    def pairs(self) -> pl.DataFrame:
        """The matrix in long form: one row a robot and human, means over episodes."""
        return tables.read_parquet(self._own(tables.PAIRS_FILE) / tables.PAIRS_FILE)

    def plot(
        self,
        path: Path | str,
        order: Literal["shared", "separate"] | None = None,
        *,
        width: float | None = None,
        bare: bool = False,
        legend: Literal["beside", "below", "none"] | None = None,
    ) -> "Figure":
        """Draw the clustered matrix, write it as .png, .pdf or .svg, and return the figure.

        Args:
            path: File to write.
            order: "shared" for one order of teams on both axes, "separate" for one order each;
                default shared if possible.
            width: Inches of the figure, for a paper's column or page; no letter is smaller than
                4 points.
            bare: Leave out title and caption.
            legend: Place of the legend; default beside or below by the room that there is, and none
                if bare.
        """
        from evaluation.plots.figures import crossplay_figure

        page = {"width": width, "bare": bare, "legend": legend}
        return crossplay_figure(self._own(), Path(path), order, **page)

    def _figures(self) -> dict[str, Estimate | None]:
        names = {"self-play": self.self_play, "cross-play": self.cross_play}
        return {**names, "self-play - cross-play": self.gap}


def load_result(folder: Path | str) -> EvaluationResult | CrossPlayResult:
    """Return the result of a finished folder.

    Raises:
        FileNotFoundError: There is none, or it is not finished.
        FormatError: It is the name of a robot.
        ValueError: A file of it is damaged, or it is neither an evaluation nor a cross-play.

    Examples:
        >>> load_result(result.folder).m_test == result.m_test
        True
    """
    check_no_robot(folder)
    folder = Path(folder)
    summary = read_summary(folder)
    if isinstance(summary, EvaluationSummary):
        return EvaluationResult.of(summary, folder)
    return CrossPlayResult.of(summary, folder)


def check_no_robot(folder: Path | str) -> None:
    """Raise a FormatError if a robot's name stands where a folder of results belongs."""
    if Path(folder).is_dir():
        return
    with contextlib.suppress(ValueError):
        parse_reference(str(folder))
        raise FormatError(
            shorten(str(folder)),
            "a folder of results",
            "the name of a robot",
            "evaluate the robot into a folder first, and give the folder",
            "nothing was read",
            remedy="evaluate first",
        )


def brief(figure: Estimate) -> str:
    """Return a mean and its interval in a few characters."""
    ends = figure.mean_ci
    return f"{figure.mean:.1f}" + (f" [{ends[0]:.1f}, {ends[1]:.1f}]" if ends else "")
