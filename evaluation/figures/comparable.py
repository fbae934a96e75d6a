"""Choose the partners on which finished evaluations are compared.

Comparisons, contrasts, leagues and figures of several folders all use `comparable`. So figures side
by side are of the same partners in the same episodes.
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.errors import counted, listing
from evaluation.cast.met_partners import MetSummary, both_met, comparison_notes
from evaluation.figures.metrics import Difference, paired_difference
from evaluation.figures.metrics.caring import CareComparison, compare_care
from evaluation.figures.normalised import summarise_references
from evaluation.figures.notes import episode_notes, seed_notes
from evaluation.figures.saved_tables import profile_table
from evaluation.figures.summary import (
    Context,
    EvaluationSummary,
    read_summary,
    summarise_evaluation,
)
from evaluation.record import tables
from evaluation.record.alike import (
    SOFTWARE,
    check_alike,
    check_members,
    conditions,
    read_identity,
    software_notes,
)
from evaluation.record.columns import SIDES
from evaluation.record.record import Record, Returns
from evaluation.record.verification import strange_tables_refused, unchecked
from population.views import plain_engine
from zoo.partners.person_ids import OWN

ADVICE = "evaluate all methods alike"
_CONTEXT = ("task", "env_version", "backend", "engine", "release", "episodes_per_pair")
_OF_SPLIT = ("split", "sha256 of the split", "preferences")


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """A finished evaluation."""

    name: str  # for readers
    summary: EvaluationSummary
    record: Record

    @classmethod
    def read(cls, folder: Path, name: str | None = None) -> "Evaluated":
        """Return the evaluation of a folder; its name is `name`, by default the folder.

        Raises:
            FileNotFoundError: The folder has no evaluation.
            ValueError: A file is damaged, or the folder has a cross-play.
        """
        with strange_tables_refused(folder):
            return cls(name or str(folder), _read_summary(folder), Record.read(folder))


@dataclasses.dataclass(frozen=True)
class Comparable:
    """Several evaluations, reduced to their common partners."""

    methods: tuple[Evaluated, ...]
    records: tuple[Record, ...]  # of the methods, with the common partners alone
    met: MetSummary  # of all methods: no record has a partner that a robot of one of them met
    # Notes on partners that differ from those of a method's own figures, and on unknown training.
    about: tuple[str, ...]
    notes: tuple[str, ...]  # that, and what else a reader has to know


@dataclasses.dataclass(frozen=True)
class MethodFigures:
    """The content of figures of several methods, by the method's name."""

    summaries: dict[str, EvaluationSummary]
    profiles: dict[str, pl.DataFrame]  # empty unless requested
    about: tuple[str, ...] = ()  # see `Comparable`


@dataclasses.dataclass(frozen=True)
class ComparisonSummary(CareComparison):
    """Method a minus method b with the partners of each side that are common to both."""

    test: Difference | None
    train: Difference | None
    notes: tuple[str, ...]
    met: MetSummary | None = None  # of both methods; sides omit training partners of either
    validation: Difference | None = None


def comparable(
    methods: Sequence[Evaluated], *, parts: Collection[str] = (), told: bool = False
) -> Comparable:
    """Return evaluations reduced to their common partners, without training partners of any robot.

    Args:
        methods: Evaluations with the same conditions, split and release, in which one id is one
            partner in the same episodes.
        parts: Names of methods that played with a part of the partners only; they keep what they
            have of the common ones, and take no partner from the others. If others played teams
            beside persons, these may have played the split of the persons alone.
        told: Whether robots that observe preferences may be compared with others.

    Raises:
        ValueError: They were not evaluated alike, or no common partner is left.
    """
    identities = _check_played_alike(methods, parts, told)
    met = both_met(*((method.summary.met, method.record.table) for method in methods))
    played = [_partners(method.record) for method in methods]
    whole = [who for who, m in zip(played, methods, strict=True) if m.name not in parts] or [
        set[str]().union(*played)
    ]
    common = set.intersection(*whole)
    if not common:
        raise ValueError(
            f"{listing(m.name for m in methods)} have no partner in common; evaluate all methods "
            "against the same split"
        )
    common.difference_update(met.left_out)
    records = tuple(m.record.without(_partners(m.record) - common) for m in methods)
    if any(record.table.is_empty() for record in records):
        raise ValueError(
            "every common partner was trained with a robot of one of the methods; choose others"
        )
    check_starts({m.name: r.returns for m, r in zip(methods, records, strict=True)})
    about, whom = [], comparison_notes(met, len(methods))
    if any(_own_partners(m) - common for m in methods if m.name not in parts):
        remaining = counted(len(common), "partner")
        about = [f"compared on the {remaining} that all have in common", *whom]
    if unknown := [method.name for method in methods if method.name not in identities]:
        about.append(
            f"no manifest says how {listing(unknown)} played: whether actions were drawn, and with "
            "which parameters of the partners, is not checked"
        )
    about += _series_notes(identities)
    notes = [*about, *whom, *(note for m in methods for note in unchecked(m.record.folder))]
    notes += software_notes({m.name: _made_with(m, identities.get(m.name)) for m in methods})
    return Comparable(tuple(methods), records, met, tuple(about), tuple(dict.fromkeys(notes)))


def method_figures(folders: Mapping[str, Path], *, profiles: bool = False) -> MethodFigures:
    """Return the figures of methods on their common partners; those of one method as it saved them.

    Args:
        folders: Of finished evaluations, by the method's name.
        profiles: Whether performance profiles are wanted.

    Raises:
        ValueError: See `comparable`.
    """
    if len(folders) == 1:
        [(name, folder)] = folders.items()
        with strange_tables_refused(folder):
            found = {name: _read_profile(folder)} if profiles else {}
            return MethodFigures({name: _read_summary(folder)}, found)
    compared = comparable([Evaluated.read(folder, name) for name, folder in folders.items()])
    figures = MethodFigures({}, {}, compared.about)
    for method, record in zip(compared.methods, compared.records, strict=True):
        own = _own_partners(method) == _partners(record)
        with strange_tables_refused(record.folder):
            figures.summaries[method.name] = (
                method.summary if own else _summarise(method, record, compared.met)
            )
            if profiles:
                figures.profiles[method.name] = (
                    _read_profile(record.folder) if own else profile_table(record)
                )
    return figures


def check_starts(played: Mapping[str, Returns]) -> None:
    """Check that methods met each partner in equal episodes, description and preference.

    Args:
        played: Each method's returns, by the method's name.

    Raises:
        ValueError: Names the partner and both methods.
    """
    known: dict[str, tuple[str, dict[str, Any], list[int], list[str]]] = {}
    for name, returns in played.items():
        if returns.keys is None:
            raise ValueError(f"robots of {name} played different episodes; evaluate them together")
        for place, row in enumerate(returns.partners.iter_rows(named=True)):
            partner, keys = row["partner"], returns.keys[place].tolist()
            facts = {f"{column} of {partner}": value for column, value in row.items()}
            drawn = returns.preferences  # None if all partners bring their own
            preferences = [OWN] * len(keys) if drawn is None else drawn[0, place].tolist()
            other, other_facts, other_keys, other_preferences = known.setdefault(
                partner, (name, facts, keys, preferences)
            )
            check_alike({other: other_facts, name: facts}, advice=ADVICE)
            if keys != other_keys:
                raise ValueError(
                    f"{name} and {other} met {partner} in different episodes; evaluate all methods "
                    "with the same seed and episodes"
                )
            if preferences != other_preferences:
                raise ValueError(
                    f"{partner} has different preferences with {name} and {other}; evaluate all "
                    "methods with the same split and preferences"
                )


def summarise_comparison(a: Record, b: Record, *, seed: int = 0) -> ComparisonSummary:
    """Summarise method a minus method b, two records of the same partners and episode keys.

    Raises:
        ValueError: The records have other partners, keys or preferences, or no partner on a side.
    """
    first, second = a.returns, b.returns
    if not first.partners.equals(second.partners):
        raise ValueError(
            "the two tables have different partners; evaluate both methods against the same split"
        )
    check_starts({"the first method": first, "the second": second})

    def difference(side: str) -> Difference | None:
        mask = (first.partners["side"] == side).fill_null(value=False).to_numpy()
        if not mask.any():
            return None
        values = first.values[:, mask], second.values[:, mask]
        groups = first.select_partners(mask).groups
        return paired_difference(*values, groups, common_starts=first.common_starts, seed=seed)

    sides = {side: difference(side) for side in SIDES}
    if not any(sides.values()):
        raise ValueError("no partner is on a side; evaluate both methods against a split")
    egos = min(first.egos.height, second.egos.height)
    notes = (*seed_notes(egos), *episode_notes(first), *episode_notes(second))
    return ComparisonSummary(
        sides["test"],
        sides["train"],
        notes,
        validation=sides["validation"],
        **vars(compare_care(first.evaluated_side, second.evaluated_side, seed=seed)),
    )


def _check_played_alike(
    methods: Sequence[Evaluated], parts: Collection[str], told: bool
) -> dict[str, dict[str, Any]]:
    """Refuse methods that were evaluated otherwise; return the identities that manifests name."""
    described, identities = {}, {}
    of_persons = _of_persons_alone(methods, parts)
    for method in methods:
        summary = method.summary
        about = {name: getattr(summary, name) for name in _CONTEXT}
        if summary.split is not None:
            about |= {"split": summary.split.id, "sha256 of the split": summary.split.sha256}
        described[method.name] = _untold(about) if told else about
        if (identity := read_identity(method.record.folder)) is not None:
            identities[method.name] = _untold(identity) if told else identity
    # With and without series the same episodes are played: what a memory is worth.
    how = {name: {**conditions(job), "series": 1} for name, job in identities.items()}
    for each in (described, how):
        check_alike({name: each[name] for name in each if name not in of_persons}, advice=ADVICE)
        # Wishes are drawn for teams alone; `check_starts` compares those of each partner.
        check_alike({n: _without(each[n], _OF_SPLIT) for n in each}, advice=ADVICE)
    check_members(identities, "partners", advice=ADVICE)
    return identities


def _of_persons_alone(methods: Sequence[Evaluated], parts: Collection[str]) -> set[str]:
    """Return those parts that played the split of the persons alone, if others played teams too."""
    with_teams = {m.name for m in methods if m.summary.split and m.summary.split.groups}
    return {m.name for m in methods if m.name in parts} - with_teams if with_teams else set()


def _without(fields: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in names}


def _series_notes(identities: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a note on the lengths of the methods' series of episodes, if they differ."""
    lengths = {name: job.get("series", 1) for name, job in identities.items()}
    if len(set(lengths.values())) < 2:
        return []
    listed = ", ".join(f"{length} in {name}" for name, length in lengths.items())
    return [f"episodes in which a robot remembers its partner: {listed}"]


def _untold(about: dict[str, Any]) -> dict[str, Any]:
    """Return the fields without the view of the robots."""
    return {**about, "engine": plain_engine(about.get("engine"))}


def _partners(record: Record) -> set[str]:
    return set(record.table["partner"].unique())


def _own_partners(method: Evaluated) -> set[str]:
    """Return the partners that the method's own figures count."""
    met = both_met((method.summary.met, method.record.table))
    return _partners(method.record).difference(met.left_out)


def _read_summary(folder: Path) -> EvaluationSummary:
    summary = read_summary(folder)
    if not isinstance(summary, EvaluationSummary):
        raise ValueError(f"{folder} holds a cross-play; give evaluations")
    return summary


def _read_profile(folder: Path) -> pl.DataFrame:
    columns = pl.col("threshold", "share", "low", "high").cast(pl.Float64)
    return tables.read_parquet(folder / tables.PROFILE_FILE).select(columns)


def _summarise(method: Evaluated, record: Record, met: MetSummary) -> EvaluationSummary:
    """Return a method's summary with only the partners of a record."""
    said = method.summary
    context = Context(**{f.name: getattr(said, f.name) for f in dataclasses.fields(Context)})
    known = said.met and dataclasses.replace(said.met, left_out=met.left_out)
    summary = dataclasses.replace(summarise_evaluation(record, context), met=known)
    if said.references is None:
        return summary
    files = (tables.REFERENCES_FILE, tables.BOUNDS_FILE)
    played, bounds = (tables.read_parquet(record.folder / name) for name in files)
    earned, relative = summarise_references(record, played, bounds)
    return dataclasses.replace(summary, references=earned, relative=relative)


def _made_with(method: Evaluated, identity: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the versions and the processor of a method's folder, as far as it names them."""
    processor = (method.record.manifest.get("made_with") or {}).get("processor")
    versions = dict((identity or {}).get(SOFTWARE) or {})
    return versions | ({"processor": processor} if processor else {})
