"""A remote's card, its README.md: content, instructions to fetch it, and self-play results."""

import re
import statistics
from collections.abc import Iterator

import yaml

from zoo.exports.card import LICENSE, render
from zoo.ids import release_number
from zoo.registry import Registry
from zoo.schema import PolicyEntry

MARK = "library_name: assistax-zoo"  # a README.md without it is not ours and stays


def model_card(
    registry: Registry, name: str, license: str = "", film: str = "", before: str = ""
) -> str:
    """Return the card's text for a remote of that name; the same registry gives the same text.

    Args:
        registry: The published registry.
        name: Name of the remote.
        license: Licence of the policies, as hubs name it; default that of `before`, or Apache-2.0.
        film: Name of a film beside the card; default that of `before`.
        before: The card that this one replaces.
    """
    was_filmed = re.search(r"\]\((film\.\w+)\)", before)
    license = license or card_license(before)
    metadata = {"license": license, **_metadata(registry, name)}
    return render(
        "model_card.md",
        head=yaml.safe_dump(metadata, sort_keys=False, allow_unicode=True),
        film=film or (was_filmed[1] if was_filmed else ""),
        name=name,
        releases=registry.data.releases,
        policies=registry.policies,
        measured=_measured(registry),
    )


def card_license(card: str) -> str:
    """Return the licence that a card names; Apache-2.0 if it names none."""
    named = re.search(r"^license: ([\w.-]+)$", card, re.MULTILINE)
    return named[1] if named else LICENSE


def _metadata(registry: Registry, name: str) -> dict[str, object]:
    """Return the card's metadata: library, tags, and self-play results if there are any."""
    results = [
        {
            "task": {"type": "reinforcement-learning", "name": f"{task}, {algorithm} with itself"},
            "dataset": {
                "type": f"assistax-{task}-{disability}",
                "name": f"{task}, disability setting {disability}",
            },
            "metrics": [
                {"type": "mean_reward", "name": "self-play return", "value": round(mean, 3)}
            ],
        }
        for task, algorithm, disability, _, mean in _measured(registry)
    ]
    tags = ["reinforcement-learning", "zero-shot-coordination", "assistive-robotics"]
    card: dict[str, object] = {
        "library_name": MARK.partition(": ")[2],
        "pipeline_tag": "reinforcement-learning",
        "tags": tags,
    }
    model = {"name": name.rpartition("/")[2], "results": results}
    return {**card, "model-index": [model]} if results else card


def _measured(registry: Registry) -> Iterator[tuple[str, str, str, int, float]]:
    """Yield task, algorithm, disability, teams and mean self-play return, in registry order.

    Each group has the teams of its newest release: an older release may hold the same teams, or
    another environment.
    """
    groups: dict[tuple[str, str, str], dict[str, PolicyEntry]] = {}
    for entry in registry.policies:
        if entry.self_play:
            group = groups.setdefault((entry.task, entry.algorithm, entry.disability), {})
            group.setdefault(entry.team, entry)
    for name, teams in groups.items():
        newest = max((entry.release for entry in teams.values()), key=release_number)
        members = [entry for entry in teams.values() if entry.release == newest]
        means = [entry.self_play.mean for entry in members if entry.self_play]
        yield *name, len(members), statistics.fmean(means)
