"""A remote's card, its README.md: what is in it, how to fetch it, and its self-play results."""

import statistics
from collections.abc import Iterator

import yaml

from zoo.card import escape
from zoo.ids import release_number
from zoo.registry import Registry
from zoo.schema import PolicyEntry

MARK = "library_name: assistax-zoo"  # a README.md without it is somebody's own and stays


def model_card(registry: Registry, name: str) -> str:
    """Return the card's text for a remote of that name; the same registry gives the same text."""
    head = yaml.safe_dump(_metadata(registry, name), sort_keys=False, allow_unicode=True)
    releases = [
        f"| {release} | {entry.date} | "
        f"{sum(policy.release == release for policy in registry.policies)} | "
        f"{escape(entry.description)} |"
        for release, entry in registry.data.releases.items()
    ]
    figures = [
        f"| {task} | {algorithm} | {disability} | {len(members)} | {_mean(members):.1f} |"
        for (task, algorithm, disability), members in _measured(registry)
    ]
    return "\n".join(
        [
            f"---\n{head}---\n# {name}\n",
            "Partners for assistive robots, as `assistax-zoo` publishes them: `registry.json` "
            "lists every policy with",
            "its spec, training and sha256; shards hold the parameters. Published bytes never "
            "change.\n",
            f"```sh\nassistax-zoo fetch 'TASK/*' --from hf://{name}\n```\n",
            "| release | date | policies | |\n|---|---|---|---|",
            *releases,
            "\nReturn of teams with themselves, mean over training seeds of the newest release "
            "that has them:\n",
            "| task | algorithm | disability | teams | return |\n|---|---|---|---|---|",
            *figures,
            "",
        ]
    )


def _metadata(registry: Registry, name: str) -> dict[str, object]:
    results = [
        {
            "task": {"type": "reinforcement-learning", "name": f"{task}, {algorithm} with itself"},
            "dataset": {
                "type": f"assistax-{task}-{disability}",
                "name": f"{task}, disability setting {disability}",
            },
            "metrics": [
                {
                    "type": "mean_reward",
                    "name": "self-play return",
                    "value": round(_mean(members), 3),
                }
            ],
        }
        for (task, algorithm, disability), members in _measured(registry)
    ]
    tags = ["reinforcement-learning", "zero-shot-coordination", "assistive-robotics"]
    card: dict[str, object] = {"library_name": MARK.partition(": ")[2], "tags": tags}
    return (
        {**card, "model-index": [{"name": name.rpartition("/")[2], "results": results}]}
        if results
        else card
    )


def _measured(registry: Registry) -> Iterator[tuple[tuple[str, str, str], list[PolicyEntry]]]:
    """Yield the teams with a self-play figure by task, algorithm and disability, in registry order.

    Of each group those of the newest release: an older one may hold the same teams, or be of
    another environment.
    """
    groups: dict[tuple[str, str, str], dict[str, PolicyEntry]] = {}
    for entry in registry.policies:
        if entry.self_play:
            groups.setdefault((entry.task, entry.algorithm, entry.disability), {}).setdefault(
                entry.team, entry
            )
    for name, teams in groups.items():
        newest = max((entry.release for entry in teams.values()), key=release_number)
        yield name, [entry for entry in teams.values() if entry.release == newest]


def _mean(members: list[PolicyEntry]) -> float:
    return statistics.fmean(entry.self_play.mean for entry in members if entry.self_play)
