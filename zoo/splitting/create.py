"""A new split of a release's partners, kept in the registry or among the user's own."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from assistax_base.errors import SplitError, listing, shorten
from assistax_base.files import exclusive
from assistax_envs.versions import PAPER, track_of
from zoo.ids import parse_team
from zoo.locations import OWN, own_registry, own_splits_file
from zoo.namespaces import qualify_split, split_namespace
from zoo.registry import Registry, load_registry
from zoo.saving import keep_split, save_registry, writable_registry
from zoo.schema import RegistryFile, Split
from zoo.splits import competent, leaks, partner_teams, refuse_leak
from zoo.splitting.rules import LEAVE_ONE_OUT, THREE, make_split
from zoo.splitting.similar_humans import similar_leak, similar_pairs


def leaves_out(task: str) -> bool:
    """Return whether a task's splits leave out partners with whom robots earn little.

    The paper's splits hold all teams, as the paper's figures do.
    """
    return track_of(task) != PAPER


def create_split(
    registry_path: Path | str | None = None,
    *,
    task: str,
    rule: str = "half",
    release: str | None = None,
    default: bool = False,
    earned: Mapping[str, float] | None = None,
    **arguments: Any,
) -> Split:
    """Make a split of a release's partners, write it to the registry, and return it.

    A split that exists is left as it is. An official registry is never written to: splits of its
    partners go to a file of the user's, and stand beside the published ones from then on.
    A leave-one-out rule leaves out training partners that act nearly as a test partner does.
    `three-sides` leaves them out too, and partners whose best response earns less than a quarter of
    the median. Outside the paper track every rule but `custom` leaves out partners of such low
    returns.

    Args:
        registry_path: The registry to write to; if not given, the one in use, or the user's own
            splits if that one is official.
        task: Task of the split.
        rule: One of `zoo.splitting.rules.RULES`.
        release: Release of the partners; the newest whole one that has the task if not given.
            "own:v0" is one of the user's own zoo.
        default: Make it the release's default split of the task.
        earned: Return of the best response to a team's human, by team; for other teams the
            self-play return is taken.
        **arguments: The others of `zoo.splitting.rules.make_split`.

    Raises:
        SplitError: The rule cannot be applied to the partners of the release.
        LeakageError: A team, the same parameters, or, by another rule, humans that act nearly alike
            would stand on two sides.
        PublishError: The registry that was given is official.
    """
    namespace, name = split_namespace(release or "")
    if registry_path is None and namespace == OWN:
        sides = {side: _own_teams(arguments.pop(side, ())) for side in ("train", "test")}
        fields: dict[str, Any] = {"task": task, "rule": rule, "release": name}
        fields["default"] = default
        named = {
            name: {team.removeprefix(f"{OWN}:"): value for team, value in (known or {}).items()}
            for name, known in (("earned", earned), ("groups", arguments.pop("groups", None)))
        }
        made = create_split(own_registry(), **fields, **sides, **named, **arguments)
        return qualify_split(made, OWN)
    path = writable_registry(registry_path)
    with exclusive(path or own_splits_file()):
        registry = load_registry(path).part("")
        split = _checked_split(
            registry, task, rule, release or registry.release_of(task), earned or {}, arguments
        )
        if path is None:
            _keep_own(registry, split, default)
        else:
            _write_split(registry, split, default)
        return split


def _checked_split(
    registry: Registry,
    task: str,
    rule: str,
    release: str,
    earned: Mapping[str, float],
    arguments: Mapping[str, Any],
) -> Split:
    """Return a split, without partners that nearly the same humans play on the other side."""
    partners = partner_teams(registry.data, task, release)
    if not partners:
        raise _no_partners(registry.data, task, release)
    if rule == THREE or (rule != "custom" and leaves_out(task)):
        partners = competent(registry.data, partners, earned)
    while True:
        split = make_split(partners, task=task, release=release, rule=rule, **arguments)
        if pairs := leaks(split, registry.data.teams):
            refuse_leak(split.id, pairs)
        alike = [pair for pair in similar_pairs(registry, split) if pair.train in partners]
        if not alike:
            return split
        if rule not in (*LEAVE_ONE_OUT, THREE):
            raise similar_leak(split.id, alike)
        twins = {pair.train for pair in alike}  # the held-out side stays whole
        partners = [team for team in partners if team not in twins]


def _keep_own(registry: Registry, split: Split, default: bool) -> None:
    if default:
        raise SplitError(
            f"default split of {split.task} {split.release}",
            "the published one",
            f"{split.id}, a split of your own",
            "make it without `default`, and name it where you choose a split",
        )
    if split not in registry.splits:
        keep_split(split)


def _write_split(registry: Registry, split: Split, default: bool) -> None:
    data = registry.data
    if split not in data.splits:
        data = data.model_copy(update={"splits": (*data.splits, split)})
    if default:
        data = with_defaults(data, split.release, {split.task: split.id})
    if data != registry.data:
        save_registry(data, registry.path)


def _own_teams(teams: Iterable[str]) -> list[str]:
    """Return the names of teams in the user's own zoo; another zoo's stay, and are then refused."""
    return [team.removeprefix(f"{OWN}:") if ":" in team else f"official {team}" for team in teams]


def with_defaults(data: RegistryFile, release: str, splits: Mapping[str, str]) -> RegistryFile:
    """Return the registry with these default splits of a release, by task, beside its others."""
    entry = data.releases[release]
    entry = entry.model_copy(update={"splits": {**entry.splits, **splits}})
    return data.model_copy(update={"releases": {**data.releases, release: entry}})


def _no_partners(data: RegistryFile, task: str, release: str) -> SplitError:
    present = sorted({f"{team.task} {team.release}" for team in map(parse_team, data.teams)})
    return SplitError(
        f"split of {shorten(task)} {shorten(release)}",
        f"a task and release with partners ({listing(present)})",
        "no partners",
        "`assistax-zoo list` prints the partners",
    )
