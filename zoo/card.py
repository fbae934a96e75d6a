"""A team's or policy's card as Markdown: what it is, how it was trained, what it reaches, and how to use it."""

from collections.abc import Mapping, Sequence
from typing import Any

_SPEC_WORDS = {
    "observation_size": "observations",
    "action_size": "actions",
    "torso": "torso",
    "hidden": "hidden layers",
    "activation": "activation",
    "squash": "actions brought into [-1, 1] by",
    "normalise": "normalised observations",
}


def markdown_card(cards: Sequence[Mapping[str, Any]], image: str | None = None) -> str:
    """Return the card of one team.

    Args:
        cards: What `assistax-zoo show --json` prints of each of its policies.
        image: Path or address of a picture, as it is to stand in the card.
    """
    first = cards[0]
    title = first["team"] if len(cards) > 1 else first["id"]
    parts = [f"# {_text(title)}"]
    if image:
        parts.append(f"![{_text(title)}](<{_address(image)}>)")
    setting = first["disability"]
    summary = {
        "release": first["release"],
        "disability": ", ".join(
            f"{name.replace('_', ' ')} {value}" for name, value in setting.items()
        ),
        **_self_play(first["self_play"]),
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


def _self_play(figures: Mapping[str, Any] | None) -> dict[str, str]:
    if figures is None:
        return {"self-play return": "not measured"}
    low, high = figures["ci"]
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
    return "\n".join(f"| {' | '.join(_text(cell) for cell in line)} |" for line in lines)


def _value(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _text(value: Any) -> str:
    """Return text that stays in its cell."""
    return " ".join(str(value).split()).replace("|", "\\|").replace("<", "&lt;")


def _address(image: str) -> str:
    return "".join(
        character for character in image if character.isprintable() and character not in "<>"
    )
