"""Command that publishes trained teams."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter
from pydantic import ValidationError

from assistax_base.errors import counted, listing
from assistax_base.validated import first_problem
from assistax_zoo.commands.options import parse_seeds
from assistax_zoo.shell.console import answer
from zoo.locations import OWN, own_registry
from zoo.saving import writable_registry
from zoo.schema import Citation

if TYPE_CHECKING:
    from population.runs.trained import TrainedTeam


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Cited:
    """Citation of a release.

    Attributes:
        author: Author of the release for `cite`; repeat it for more, in order.
        title: Title by which `cite` calls the release.
        url: Address of the release or its paper, for `cite`.
    """

    author: tuple[str, ...] = ()
    title: str = ""
    url: str = ""

    def given(self) -> Citation | None:
        """Return the citation, or None if no part of it is given."""
        if not (self.author or self.title or self.url):
            return None
        try:
            return Citation(authors=self.author, title=self.title, url=self.url)
        except ValidationError as error:
            raise ValueError(f"citation: {first_problem(error)}") from None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Card:
    """Licence and film of a remote's card.

    Attributes:
        license: Licence of the policies, as hubs name it; default apache-2.0.
        film: Film for the card: .gif, .webp or .mp4, as `assistax-zoo render` writes it.
    """

    license: str = ""
    film: Path | None = None


def publish(
    *runs: Path,
    release: str,
    seeds: str = "",
    persons: tuple[str, ...] = (),
    to: str | None = None,
    registry: Path | None = None,
    date: str | None = None,
    description: str = "",
    cited: Cited = Cited(),
    card: Card = Card(),
    key: Path | None = None,
    json: bool = False,
) -> None:
    """Publish the teams or egos of run folders in a release: shards, registry, split and card.

    Without --to and --registry they join your own zoo, as own:scratch/... Published data never
    changes; publishing the same run again does nothing. A hub gets one commit, then a tag.

    Args:
        runs: Run folders that `assistax-zoo train` or `train-ego` wrote.
        release: Release that the teams join, such as v0; it is made if it does not exist.
        seeds: Seeds to publish, such as 3 for 0 to 2, or 0,4,7; all if not given.
        persons: Task whose persons join the release, such as a task of your own; repeat it for
            more.
        to: Folder, or hf://org/name, to publish to; it is made if it does not exist.
        registry: Registry to publish to instead, without a card.
        date: ISO date of a new release; default today.
        description: One sentence on a new release.
        cited: How others cite the release.
        card: Licence and film of the card.
        key: Ed25519 private key, PEM, to sign the release with.
        json: Print JSON.

    Example:
        assistax-zoo publish runs/scratch-ippo-d1 runs/scratch-ippo-d9 --release v0 --to zoos/mine
    """
    from assistax_workshop.press.hub_publish import publish_to
    from assistax_workshop.press.trained_runs import read_run

    if not runs and not persons:
        raise ValueError("no run folder given; name at least one, for example runs/scratch-ippo-d1")
    if to and registry:
        raise ValueError(
            "both --to and --registry given; --to takes a folder or hf://org/name, and is enough"
        )
    teams = _of_seeds([team for run in runs for team in read_run(run)], seeds)
    place = to or writable_registry(registry) or own_registry()
    about: dict[str, Any] = {"date": date, "description": description, "citation": cited.given()}
    about["persons"] = persons
    done = publish_to(teams, str(place), release, **about, **vars(card), key=key)
    new = counted(len(done.added), "new policy")
    new += "".join(f" and the persons of {task}" for task in persons)
    published = f"published {new} in release {release} of {done.registry}"
    lines = [f"{published}; it holds {done.policies}"]
    if place == own_registry():
        done = dataclasses.replace(done, added=tuple(f"{OWN}:{id}" for id in done.added))
        lines.append(f"they are {OWN}:... everywhere: assistax-zoo list '{OWN}:*'")
    answer(json, vars(done), *lines)


def _of_seeds(teams: "Sequence[TrainedTeam]", seeds: str) -> "Sequence[TrainedTeam]":
    """Return the teams of the seeds that a text names; all of them if it is empty."""
    if not seeds:
        return teams
    wanted, there = parse_seeds(seeds), sorted({team.seed for team in teams})
    if missing := [seed for seed in wanted if seed not in there]:
        allowed = listing(map(str, there))
        raise ValueError(f"seed {missing[0]} is not in the runs; allowed are {allowed}")
    return [team for team in teams if team.seed in wanted]
