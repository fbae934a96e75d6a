"""Commands over the published population: list, show, verify."""

import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assistax_base.errors import UnknownIdError, counted, listing, printable, shorten
from assistax_envs.persons.rows import PROGRAM_VERSION
from assistax_envs.registered import track_of
from assistax_envs.versions import TASKS
from assistax_zoo.commands.partners.provenance import verify_results
from assistax_zoo.shell.console import MOST_LINES, answer, first_lines, progress, stdout_is_data
from population.networks.spec import Role
from zoo.exports.card import find_cards, write_card
from zoo.ids import EGO
from zoo.namespaces import split_namespace
from zoo.partners.person_tables import person_tables
from zoo.registry import Registry, load_registry
from zoo.schema import Persons, PolicyEntry

if TYPE_CHECKING:
    from evaluation.replay.self_play_check import SelfPlayReport, TeamReplay
    from zoo.verify import Report

_ALONE = "a robot alone has no self-play; `assistax-zoo evaluate NAME` measures its M_test"


def list_policies(
    pattern: str | None = None,
    *,
    task: str | None = None,
    algorithm: str | None = None,
    disability: str | None = None,
    role: Role | None = None,
    release: str | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """List the published policies: a line for each kind, or for each policy of a glob.

    Args:
        pattern: A task, for its kinds alone; or a glob over ids, such as `'scratch/ippo-*/human'`,
            for a line each; `'*'` for all.
        task: Only this task.
        algorithm: Only this algorithm.
        disability: Only this disability setting, such as d3.
        role: Only this role.
        release: Only this release, such as v1.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo list scratch
    """
    fields = {"algorithm": algorithm, "disability": disability, "role": role, "release": release}
    loaded = load_registry(registry)
    if pattern in TASKS:
        task, pattern = pattern, None
    kinds = not (pattern or algorithm or disability or role)
    persons = [table for table in person_tables(loaded.data) if task in (None, table[1])]
    persons = [table for table in persons if kinds and release in (None, table[0])]
    try:
        entries = loaded.select(pattern, task=task, **fields)
    except UnknownIdError:
        if not persons:
            raise
        entries = []
    if kinds:
        columns = ("track", "task", "kind", "number", "names")
        rows = _kind_rows(entries, persons, by_algorithm=task is not None)
        caption = f"{counted(len(entries), 'policy')}; a task or a glob of names lists more"
    else:
        columns, rows, caption = _policy_rows(entries)
    lines = table_lines(columns, rows, caption)
    answer(json, [entry.brief() for entry in entries], *lines)


def show(
    id: str,
    *,
    card: Path | None = None,
    image: Path | None = None,
    result: Path | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Show the card of a policy or a team: spec, provenance, self-play, splits, bytes.

    Args:
        id: A policy's id, or a team's for both its policies.
        card: Write the card to this file too, as Markdown to be shared.
        image: Picture or film for the written card.
        result: Folder that `evaluate` wrote for this robot alone; its M_test goes into the card.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo show scratch/ippo-d3-s5-v1/human
    """
    if image and not card:
        raise ValueError(
            "--image goes into a card that is written; name the card's file with --card"
        )
    loaded = load_registry(registry)
    cards = find_cards(loaded, id)
    if result:
        cards[0] |= {"m_test": _m_test(result, cards[0]["id"])}
    if card:
        write_card(cards, card, image, "NAME:" if registry else "")
    lines = [line for content in cards for line in _card_lines(content)]
    answer(json, cards[0] if cards[0]["id"] == id else cards, *lines)


def verify(
    pattern: str | None = None,
    *,
    deep: bool = False,
    release: str | None = None,
    episodes: int = 4,
    backend: Literal["auto", "fused", "native", "mjx", "mjx-warp"] = "native",
    key: Path | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Check every published byte, split, figure and reference; exit code 1 if anything is wrong.

    Given a folder of results, the command compares its files with the folder's manifest instead,
    and also what they depend on, as far as it is here: policies, entries of the registry, own
    robots' files. With --deep the policies are loaded and stepped too, and the teams replay their
    self-play, each under its own disability setting: this tests the installed MuJoCo, MJX and JAX.

    Args:
        pattern: A folder of results; or a glob over the policies that --deep replays, default all.
        deep: Replay self-play, and compare it with the recorded returns.
        release: Only this release, with --deep.
        episodes: Episodes of each team, with --deep.
        backend: Physics backend, with --deep.
        key: Ed25519 public key, PEM, that every release must be signed by.
        registry: Registry to check instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo verify 'scratch/ippo-d1-*' --deep
    """
    if pattern and not deep and Path(pattern).is_dir():
        if not verify_results(Path(pattern), registry, json):
            raise SystemExit(1)
        return
    if pattern and not deep:
        raise ValueError(
            f"{shorten(pattern)} is no folder here; name a folder of results, or add --deep to "
            "choose policies by a pattern"
        )
    if release and not deep:
        raise ValueError(
            "--release chooses what --deep replays; bytes are always checked all: add --deep"
        )
    from zoo.verify import verify as verify_registry

    loaded = load_registry(registry, roots=False)
    report = verify_registry(loaded, key=key)
    content, lines, ok = {"ok": report.ok, **vars(report)}, _report_lines(report), report.ok
    if deep:
        replay = _replay_teams(loaded, pattern, release, episodes, backend)
        lines, ok = [*lines, *_replay_lines(replay)], ok and replay.ok
        content |= {"ok": ok, "deep": replay.to_json()}
    answer(json, content, *lines)
    if not ok:
        raise SystemExit(1)


def _kind_rows(
    entries: Sequence[PolicyEntry],
    persons: Sequence[tuple[str, str, Persons]],
    by_algorithm: bool,
) -> list[tuple[str, ...]]:
    """Return track, task, kind, count and glob of each kind of a task's partners and robots.

    Args:
        entries: Policies of teams, and robots without a human.
        persons: Release, task and table of persons.
        by_algorithm: Whether teams and robots of each algorithm have a line of their own.
    """
    counts: Counter[tuple[str, str, str, str]] = Counter()
    for entry in {entry.team: entry for entry in entries}.values():
        zoo, algorithm = split_namespace(entry.id)[0], entry.algorithm if by_algorithm else "*"
        kind, names = ("robots", "*-ego-*") if entry.disability == EGO else ("teams", "*")
        names = names if algorithm == "*" else f"{algorithm}-{names.removeprefix('*-')}"
        glob = f"{zoo}{':' * bool(zoo)}{entry.task}/{names}"
        counts[track_of(entry.task), entry.task, f"{kind} by {algorithm}", glob] += 1
    for release, task, table in persons:
        zoo, kind = split_namespace(release)[0], "persons"
        if table.program != PROGRAM_VERSION:
            kind += " of another program, which cannot be played here"
        counts[track_of(task), task, kind, f"{zoo}{':' * bool(zoo)}{task}/person-*"] += table.count
    places = {task: place for place, task in enumerate(TASKS)}
    rows = sorted(counts.items(), key=lambda row: (places.get(row[0][1], len(places)), *row[0]))
    return [
        (track, task, kind.removesuffix(" by *"), str(count), glob)
        for (track, task, kind, glob), count in rows
    ]


def _policy_rows(
    entries: Sequence[PolicyEntry],
) -> tuple[tuple[str, ...], list[tuple[str, ...]], str]:
    """Return columns, a row for each policy, and a caption; self-play is of teams alone."""
    caption = counted(len(entries), "policy")
    if any(entry.disability == EGO for entry in entries):
        caption += f"; {_ALONE}"
    if not any(_is_of_team(entry) for entry in entries):
        return ("policy",), [(entry.id,) for entry in entries], caption
    columns = ("policy", "self-play", "95% interval", "episodes")
    return columns, [(entry.id, *_figures(entry)) for entry in entries], caption


def _is_of_team(entry: PolicyEntry) -> bool:
    """Return whether a policy was trained beside its own human or robot."""
    return bool(entry.shard) and entry.disability != EGO


def _report_lines(report: "Report") -> list[str]:
    done = "verified" if report.ok else f"{counted(len(report.problems), 'problem')} in"
    return [
        *first_lines("problem: ", report.problems, "problem"),
        *(f"note: {note}" for note in report.notes),
        *(f"root of {release}: {root}" for release, root in report.roots.items()),
        f"{done} {counted(report.shards, 'shard')} ({report.bytes} bytes), "
        f"{counted(report.policies, 'policy')}, {counted(report.splits, 'split')}, "
        f"{counted(report.persons, 'person')} of {report.registry}",
    ]


def _m_test(folder: Path, robot: str) -> dict[str, Any]:
    from evaluation.figures.summary import EvaluationSummary, read_summary

    found = read_summary(folder)
    is_its_own = isinstance(found, EvaluationSummary) and found.egos == (robot,)
    if is_its_own and found.split and found.m_test:
        figures = {name: getattr(found.m_test, name) for name in ("mean", "mean_ci", "n")}
        if figures["mean_ci"]:
            return {**figures, "split": found.split.id}
    raise ValueError(
        f"{folder} has no M_test of {robot} alone with an interval; make one with "
        f"`assistax-zoo evaluate {robot} --out FOLDER`, with two partners or more"
    )


def _card_lines(card: dict[str, Any]) -> list[str]:
    lines = [card["id"]]
    for name, value in card.items():
        if isinstance(value, dict):
            lines += [f"  {name}", *(f"    {key:18} {_text(value[key])}" for key in value)]
        elif name != "id":
            absent = _ALONE if card.get("trained_against") else "not measured"
            lines.append(f"  {name:20} {absent if value is None else value}")
    return [printable(line) for line in lines]


def _text(value: Any) -> str:
    if isinstance(value, dict) and "low" in value:  # a person's number, beside its range
        unit = "" if value["unit"] == "1" else value["unit"]
        none = f", none in {value['none']:.0%}" if value["none"] else ""
        return f"{value['value']:<8g} {unit:9} [{value['low']:g} to {value['high']:g}{none}]"
    if isinstance(value, dict):
        return ", ".join(f"{key} {item}" for key, item in value.items()) or "-"
    return "-" if value is None else str(value)


def _figures(entry: PolicyEntry) -> tuple[str, str, str]:
    if (self_play := entry.self_play) is None:
        return "not measured" if _is_of_team(entry) else "-", "", ""
    low, high = self_play.mean_ci
    return f"{self_play.mean:.1f}", f"{low:.1f} to {high:.1f}", str(self_play.n)


def _replay_teams(
    registry: Registry, pattern: str | None, release: str | None, episodes: int, backend: str
) -> "SelfPlayReport":
    """Run `verify --deep`: progress on standard error, nothing on standard output."""
    from evaluation.replay.self_play_check import check_self_play

    entries = registry.select(pattern, release=release)
    with (
        stdout_is_data(),
        progress("replay teams", len({entry.team for entry in entries})) as advance,
    ):
        return check_self_play(
            registry, entries, episodes=episodes, backend=backend, on_progress=advance
        )


def _replay_lines(result: "SelfPlayReport") -> list[str]:
    """Return expected and found returns of each team, the versions, and a verdict."""
    done = "replayed" if result.ok else f"{counted(len(result.problems), 'problem')} in"
    start = "not replayed, trained on another version of the environment: "
    outdated = [start + listing(result.outdated, MOST_LINES)] if result.outdated else []
    return [
        ", ".join(f"{name} {version}" for name, version in result.versions.items()),
        *(_team_line(team, result.episodes) for team in result.teams),
        *first_lines("problem: ", result.problems, "problem"),
        *outdated,
        *(
            f"{drift.task}: mean difference {drift.found:+.2%}, allowed {drift.tolerance:.2%}"
            for drift in result.drifts
        ),
        f"{done} {counted(len(result.teams), 'team')} of {counted(result.episodes, 'episode')} on "
        f"{result.backend}, {counted(result.policies, 'policy')} stepped",
    ]


def _team_line(team: "TeamReplay", episodes: int) -> str:
    known = team.expected is not None
    expected = f"{team.expected:.1f} within {team.tolerance:.1f}" if known else "not recorded"
    more = f" in {team.episodes} episodes" if team.episodes > episodes else ""
    verdict = "ok     " if team.ok else "differs"
    return f"{verdict} {team.team:28} expected {expected}, found {team.found:.1f}{more}"


def table_lines(columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> list[str]:
    """Return aligned columns, heads bold on a terminal; rich takes 0.3 s for a thousand rows."""
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    lines = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in (columns, *rows)]
    if sys.stdout.isatty() and not os.environ.get("NO_COLOR"):
        lines[0] = f"\033[1m{lines[0]}\033[0m"
    return [*lines, caption]
