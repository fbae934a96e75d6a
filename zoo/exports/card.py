"""Card of a team or a policy: its spec, its training, its returns, and commands to use it."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_base.errors import printable
from assistax_base.files import atomic_write
from zoo.registry import Registry

LICENSE = "apache-2.0"  # of the partners of this project
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
        UnknownIdError: No policy or team has that id. The error names the nearest ids.
    """
    name = registry.full(name)
    entries = [entry for entry in registry.policies if name in (entry.id, entry.team)]
    entries = entries or registry.known([f"{name}/human"]) or [registry.policy(name)]
    return [registry.source_of(entry.id).card(entry) for entry in entries]


def write_card(
    cards: Sequence[Mapping[str, Any]], path: Path, image: Path | None = None, namespace: str = ""
) -> None:
    """Write a card as Markdown; the address of its picture is relative to the card.

    A robot's card may have `m_test`: `mean`, `mean_ci`, `n` partners, and their `split`. In
    commands `namespace` is a prefix of ids: "NAME:" for a zoo that readers have to add first.

    Raises:
        ValueError: There is no such picture.
    """
    if image is not None and not image.is_file():
        raise ValueError(
            f"no picture at {image}; render one with `assistax-zoo render`, or leave it out"
        )
    folder = path.resolve().parent
    place = Path(os.path.relpath(image.resolve(), folder)).as_posix() if image else None
    atomic_write(path, markdown_card(cards, place, namespace).encode())


def markdown_card(
    cards: Sequence[Mapping[str, Any]], image: str | None = None, namespace: str = ""
) -> str:
    """Return the card of one team.

    Args:
        cards: Of each of its policies, see `find_cards`.
        image: Path or address of a picture, as it is to stand in the card.
        namespace: Prefix of its ids in commands, such as "lab:"; empty for the official zoo.
    """
    first = cards[0]
    many = len(cards) > 1
    if "numbers" in first:
        return render("person.md", card=first, image=image)
    setting = (f"{name.replace('_', ' ')} {value}" for name, value in first["disability"].items())
    summary = {"release": first["release"], "disability": ", ".join(setting), **_figures(first)}
    summary |= {f"side of {split}": side for split, side in first["splits"].items()}
    policies = [
        ("id", *(card["id"] for card in cards)),
        *(
            (word, *(card["spec"][field] for card in cards))
            for field, word in _SPEC_WORDS.items()
            if field in first["spec"]
        ),
        ("sha256", *(f"`{card['sha256']}`" for card in cards)),
    ]
    return render(
        "card.md",
        head=_head(first),
        cards=cards,
        image=image,
        title=first["team"] if many else first["id"],
        namespace=namespace,
        summary=summary.items(),
        policies=policies,
        training=_flat(first["training"]),
        # Not a default: that of another release is played in another version of the task.
        split=first.get("trained_against", {}).get("split")
        or next((namespace + split for split in first["splits"]), "test"),
    )


def _head(card: Mapping[str, Any]) -> str:
    """Return the metadata for hubs as YAML: licence, kind, and M_test or the self-play return."""
    from huggingface_hub import EvalResult, ModelCardData

    task, m_test = card["id"].split("/")[0], card.get("m_test")
    figures = m_test or card.get("self_play")
    measured = figures and EvalResult(
        task_type="reinforcement-learning",
        dataset_type=f"assistax-{task}",
        dataset_name=m_test["split"]
        if m_test
        else f"{task}, disability setting {card['disability']['setting']}",
        metric_type="mean_reward",
        metric_name="M_test" if m_test else "self-play return",
        metric_value=round(figures["mean"], 3),
    )
    data = ModelCardData(
        license=LICENSE,
        library_name="assistax-zoo",
        pipeline_tag="reinforcement-learning",
        tags=["zero-shot-coordination", "assistive-robotics"],
        model_name=card["team"],
        eval_results=[measured] if measured else None,
    )
    return data.to_yaml()


def _figures(card: Mapping[str, Any]) -> dict[str, str]:
    against, m_test, figures = (card.get(k) for k in ("trained_against", "m_test", "self_play"))
    success = (figures or {}).get("success")
    with_itself = f"{_mean(figures)} over {figures['n']} episodes" if figures else "not measured"
    rows = {
        "trained against the training side of": against and against["split"],
        "M_test": m_test
        and f"{_mean(m_test)}, with {m_test['n']} partners of the test side of {m_test['split']}",
        "self-play return": None if against else with_itself,
        "self-play success": None if success is None else f"{success:.0%}",
    }
    return {name: text for name, text in rows.items() if text}


def _mean(figures: Mapping[str, Any]) -> str:
    low, high = figures["mean_ci"]
    return f"{figures['mean']:.1f}, 95% interval {low:.1f} to {high:.1f}"


def _flat(training: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the known fields of a training, those of an object by `name.key`."""
    rows = []
    for name, value in training.items():
        pairs = value.items() if isinstance(value, Mapping) else ()
        rows += [(f"{name}.{key}", item) for key, item in pairs]
        rows += [] if value is None or isinstance(value, Mapping) else [(name, value)]
    return rows


def render(template: str, **values: Any) -> str:
    """Return the text of a template of `zoo/templates`; the filter `cell` escapes table cells."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("zoo"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"cell": escape, "address": _address}
    return environment.get_template(template).render(**values)


def escape(value: Any) -> str:
    """Return text that stays in its cell, and is neither a link nor HTML."""
    value = ", ".join(map(str, value)) if isinstance(value, list | tuple) else value
    text = " ".join(printable(str(value)).split())
    for character in "\\|[]":
        text = text.replace(character, f"\\{character}")
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _address(image: str) -> str:
    return "".join(
        character for character in image if character.isprintable() and character not in "<>"
    )
