"""Teams: partners whose parameters the registry's shards hold, and their stored splits."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from assistax_base.errors import SplitError, listing, nearest, shorten
from zoo.namespaces import qualify_split, split_namespace
from zoo.partners.sides import SIDES, parse_split
from zoo.partners.source import PartnerSource
from zoo.schema import PolicyEntry, Sha256, Split, Team
from zoo.selection import select
from zoo.splits import check_split, leaks, refuse_leak

if TYPE_CHECKING:
    from population.networks.stack import PolicyStack

# Team -> sha256 of its human.
Humans = dict[Annotated[str, Field(max_length=200)], Sha256 | None]


class Teams(PartnerSource):
    """The teams of the registry, which are all policies that no other kind owns."""

    word = ""

    @classmethod
    def owns(cls, name: str) -> bool:
        """Return True: a registry asks the other kinds first."""
        return True

    @classmethod
    def names_split(cls, text: str) -> bool:
        """Return False: a split of teams has no word."""
        return False

    def select(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Return the policies that match one of the globs, in the registry's order."""
        return select(self.registry.policies, patterns)

    def candidates(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Return all policies, so that an error can name those near to a pattern."""
        return self.registry.policies

    def known(self, ids: Iterable[str]) -> list[PolicyEntry]:
        """Return the policies of these ids in the registry's order; unknown ids are skipped."""
        wanted = set(ids)
        return [entry for entry in self.registry.policies if entry.id in wanted]

    def split(self, task: str, name: str | None, release: str | None = None) -> Split | None:
        """Return a stored split, verified; see `Registry.split`."""
        registry = self.registry
        namespace, plain = split_namespace(name or release or "")
        if namespace and namespace in registry.parts:
            arguments = {"id": plain or None} if name else {"release": plain}
            theirs = qualify_split(registry.parts[namespace].split(task, **arguments), namespace)
            # A lock narrows the splits of the registry down.
            if registry.source_of_split(theirs) is self and theirs not in registry.splits:
                raise SplitError(f"split {theirs.id}", "one of this registry", "none")
            return theirs
        split = self._named(task, name) if name else self._default(task, release or "")
        return split and self._verified(split)

    def stacks(self, entries: Sequence[PolicyEntry]) -> "tuple[PolicyStack, ...]":
        """Return the parameters of entries from their shards, hashes checked."""
        from zoo.parameters.storage import load_shards

        return load_shards(self.registry, entries)

    def choose(
        self,
        task: str,
        split: str | None,
        patterns: str | Sequence[str] | None,
        most: int | None = None,
    ) -> tuple[Split, list[PolicyEntry]]:
        """Return a split, and the humans of its sides that match the patterns.

        The default split is that of the release that the matching partners are of, if they are of
        one, else the task's own.
        """
        registry = self.registry
        if most is not None:
            raise ValueError(f"persons is {most}, but teams of {task} are meant; leave it out")
        name, side = parse_split(split, registry.parts)
        if name and not any(e.task == task and e.role == "human" for e in registry.policies):
            raise ValueError(self._unknown(task, name))
        humans = registry.select(patterns, task=task, role="human")
        releases = {entry.release for entry in humans}
        release = releases.pop() if len(releases) == 1 else None
        try:
            manifest = registry.split(task, name, release=release)
        except SplitError:
            if name is None:
                raise
            raise ValueError(self._unknown(task, name)) from None
        allowed = {team for part in SIDES[side] for team in getattr(manifest, part)}
        chosen = [entry for entry in humans if entry.team in allowed]
        if not chosen:
            raise ValueError(
                f"none of the partners that match ({len(humans)}) is on the "
                f"{' or '.join(SIDES[side])} side of split {manifest.id}; choose others, another "
                "side, or another split's id (assistax-zoo split list)"
            )
        return manifest, chosen

    def identities(self, split: Split) -> dict[str, str | None]:
        """Return the sha256 of the humans of a split's training side, by team."""
        return humans_of(self.registry.data.teams, split.train)

    def teams_of(self, split: Split) -> Sequence[str]:
        """Return the teams of all sides."""
        return [team for side in split.sides.values() for team in side]

    def offered(self, task: str, release: str) -> str | None:
        """Return how to choose a release's default split; None for a release of egos alone."""
        split = self.registry.data.releases[release].splits.get(task)
        return f"split {split}" if split else None

    def public(self, task: str, split: Split) -> list[PolicyEntry]:
        """Return the humans of a task's default release."""
        return self.registry.of_task(task, "human")

    def card(self, entry: PolicyEntry) -> dict[str, Any]:
        """Return all that is known of a policy, JSON-ready."""
        sides = {split.id: split.side(entry.team) for split in self.registry.splits}
        against = entry.trained_against
        card = super().card(entry)
        digest = card.pop("sha256")
        card["self_play"] = entry.self_play.model_dump(mode="json") if entry.self_play else None
        fields = {name: card.pop(name) for name in ("training", "splits")}
        return {
            **card,
            **({"trained_against": against.model_dump(mode="json")} if against else {}),
            "training": {"run": entry.run, "seed": entry.seed, **fields["training"]},
            "splits": {split: side for split, side in sides.items() if side},
            "shard": {
                "path": entry.shard,
                "row": entry.row,
                "sha256": self.registry.data.shards[entry.shard].sha256,
            },
            "sha256": digest,
        }

    def _verified(self, split: Split) -> Split:
        """Return a stored split if its content, its teams and their parameters hold."""
        check_split(split)
        teams = self.registry.data.teams
        named = [team for side in split.sides.values() for team in side]
        missing = [team for team in named if team not in teams]
        if missing:
            raise SplitError(
                f"split {split.id}", "teams of the registry", f"unknown {listing(missing)}"
            )
        pairs = leaks(split, teams)
        if pairs:
            refuse_leak(split.id, pairs)
        return split

    def _named(self, task: str, name: str) -> Split:
        registry = self.registry
        known = [split for split in registry.splits if split.task == task]
        full = name if "/" in name else f"{task}/{name}"
        exact = [split for split in known if split.id == full]
        matching = exact or [split for split in known if split.id.startswith(f"{full}-")]
        newest, releases = registry.release_of(task), registry.data.releases.values()
        # A split that a user makes later does not take over the name of a default split.
        defaults = {id for release in releases for id in release.splits.values()}
        default = [split for split in matching if split.id in defaults]
        candidates = [matching, default]
        candidates += [
            [split for split in few if split.release == newest] for few in candidates[::-1]
        ]
        for few in candidates:
            if len(few) == 1:
                return few[0]
        ids = [split.id for split in known]
        release = registry.data.release
        made = (source for source in registry.sources if source.word)
        words = [source.word for source in made if source.offered(task, release)]
        close = nearest(full, ids) or ids or words
        raise SplitError(
            f"split {shorten(name)} of task {shorten(task)}",
            f"one split ({listing(close)})",
            f"{len(matching)} that begin so" if matching else "none",
        )

    def _default(self, task: str, release: str) -> Split | None:
        """Return a release's stored default split of a task; None if it has none."""
        registry = self.registry
        if release not in registry.data.releases:
            allowed = f"one of {listing(registry.data.releases)}"
            raise SplitError(f"release {shorten(release)}", allowed, "no such release")
        named = registry.data.releases[release].splits.get(task)
        return next((split for split in registry.splits if split.id == named), None)

    def _unknown(self, task: str, name: str) -> str:
        """Say that neither a side nor a split has this name, and which names are near."""
        ids = [split.id for split in self.registry.data.splits if split.task == task]
        words = [source.word for source in self.registry.sources if source.word]
        near = nearest(name, [*SIDES, *words, *ids])
        return (
            f"split {name!r} is neither a side ({', '.join(SIDES)}) nor a split's id"
            f"{f', nearest: {listing(near)}' if near else ''}; "
            "`assistax-zoo split list` prints the ids"
        )


def humans_of(teams: Mapping[str, Team], names: Iterable[str], namespace: str = "") -> Humans:
    """Return the sha256 of each team's human; None for a team that the zoo does not have."""
    humans: Humans = {}
    for name in names:
        team = teams.get(name) or teams.get(name.removeprefix(f"{namespace}:"))
        human = team.policies.get("human") if team else None
        humans[name] = human.sha256 if human else None
    return humans
