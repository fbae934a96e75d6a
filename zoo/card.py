"""A team's or policy's card: what it is, how it was trained, what it reaches, how to use it."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from population.files import atomic_write
from zoo.errors import printable
from zoo.registry import Registry
from zoo.schema import PolicyEntry

_SPEC_WORDS = {
    "observation_size": "observations",
    "action_size": "actions",
    "torso": "torso",
    "hidden": "hidden layers",
    "activation": "activation",
    "squash": "actions brought into [-1, 1] by",
    "normalise": "normalised observations",
}


def find_cards(registry: Registry, name: str) -> list[dict[str, Any]]:
    """Return the card of a policy, or of both policies of a team, JSON-ready.

    Raises:
        UnknownIdError: There is none of that id; the nearest ids are named.
    """
    found = [entry for entry in registry.policies if name in (entry.id, entry.team)]
    return [policy_card(registry, entry) for entry in found or [registry.policy(name)]]


def policy_card(registry: Registry, entry: PolicyEntry) -> dict[str, Any]:
    """Return everything known of a policy, JSON-ready."""
    sides = {split.id: split.side(entry.team) for split in registry.splits}
    setting = dataclasses.asdict(entry.setting) if entry.setting else {}
    against = entry.trained_against
    return {
        "id": entry.id,
        "team": entry.team,
        "release": entry.release,
        "disability": {"setting": entry.disability, **setting},
        "spec": entry.spec.to_json(),
        "self_play": entry.self_play.model_dump(mode="json") if entry.self_play else None,
        **({"trained_against": against.model_dump(mode="json")} if against else {}),
        "training": {
            "run": entry.run,
            "seed": entry.seed,
            **entry.training.model_dump(mode="json"),
        },
        "splits": {split: side for split, side in sides.items() if side},
        "shard": {
            "path": entry.shard,
            "row": entry.row,
            "sha256": registry.data.shards[entry.shard].sha256,
        },
        "sha256": entry.sha256,
    }


def write_card(cards: Sequence[Mapping[str, Any]], path: Path, image: Path | None = None) -> None:
    """Write a card as Markdown; a picture stands in it relative to the card.

    Raises:
        ValueError: There is no such picture.
    """
    if image is not None and not image.is_file():
        raise ValueError(
            f"no picture at {image}; render one with `assistax-zoo render`, or leave --image out"
        )
    folder = path.resolve().parent
    place = Path(os.path.relpath(image.resolve(), folder)).as_posix() if image else None
    atomic_write(path, markdown_card(cards, place).encode())


def markdown_card(cards: Sequence[Mapping[str, Any]], image: str | None = None) -> str:
    """Return the card of one team.

    Args:
        cards: `policy_card` of each of its policies.
        image: Path or address of a picture, as it is to stand in the card.
    """
    first = cards[0]
    title = first["team"] if len(cards) > 1 else first["id"]
    parts = [f"# {escape(title)}"]
    if image:
        parts.append(f"![{escape(title)}](<{_address(image)}>)")
    setting = first["disability"]
    summary = {
        "release": first["release"],
        "disability": ", ".join(
            f"{name.replace('_', ' ')} {value}" for name, value in setting.items()
        ),
        **_figures(first),
        **{f"side of {split}": side for split, side in first["splits"].items()},
    }
    parts.append(_table(("", ""), summary.items()))
    parts += [
        "## Policies",
        _policies(cards),
        "## Training",
        _table(("", ""), _training(first["training"])),
    ]
    parts += ["## Use", f"```sh\n{_usage(cards)}\n```"]
    return "\n\n".join(parts) + "\n"


def _figures(card: Mapping[str, Any]) -> dict[str, str]:
    if "trained_against" in card:
        return {"trained against the training half of": card["trained_against"]["split"]}
    figures = card["self_play"]
    if figures is None:
        return {"self-play return": "not measured"}
    low, high = figures["mean_ci"]
    told = (
        f"{figures['mean']:.1f}, 95% interval {low:.1f} to {high:.1f} over {figures['n']} episodes"
    )
    success = figures.get("success")
    return {
        "self-play return": told,
        **({} if success is None else {"self-play success": f"{success:.0%}"}),
    }


def _policies(cards: Sequence[Mapping[str, Any]]) -> str:
    rows: dict[str, list[Any]] = {"id": [card["id"] for card in cards]}
    rows |= {
        word: [_value(card["spec"][field]) for card in cards] for field, word in _SPEC_WORDS.items()
    }
    rows["sha256"] = [f"`{card['sha256']}`" for card in cards]
    return _table(
        ("", *(card["spec"]["role"] for card in cards)),
        [(name, *values) for name, values in rows.items()],
    )


def _training(training: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows = []
    for name, value in training.items():
        if isinstance(value, Mapping):
            rows += [(f"{name}.{key}", _value(item)) for key, item in value.items()]
        elif value is not None:
            rows.append((name, _value(value)))
    return rows


def _usage(cards: Sequence[Mapping[str, Any]]) -> str:
    lines = []
    for card in cards:
        task = card["id"].partition("/")[0]
        if card["spec"]["role"] == "robot":
            lines.append(
                f"assistax-zoo evaluate --task {task} --policy zoo:{card['id']} --split test --out "
                "results"
            )
        lines.append(
            f"assistax-zoo export {card['id']} --format onnx --out {card['spec']['role']}.onnx"
        )
    return "\n".join(lines)


def _table(columns: Sequence[str], rows: Any) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(escape(cell) for cell in line)} |" for line in lines)


def _value(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def escape(value: Any) -> str:
    """Return text that stays in its cell, and is neither a link nor HTML."""
    text = " ".join(printable(str(value)).split())
    for character in "\\|[]":
        text = text.replace(character, f"\\{character}")
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _address(image: str) -> str:
    return "".join(
        character for character in image if character.isprintable() and character not in "<>"
    )
