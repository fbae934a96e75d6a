import dataclasses
from typing import Any

import pytest
from huggingface_hub import ModelCard, ModelCardData

from assistax_workshop.press.model_card import model_card
from zoo.exports.card import markdown_card
from zoo.registry import Registry

CARD: dict[str, Any] = {
    "id": "scratch/ippo-d3-s5-v0/robot",
    "team": "scratch/ippo-d3-s5-v0",
    "release": "v0",
    "disability": {"setting": "d3", "strength": 0.4, "elbow_range": 1.0, "tremor": 0.0},
    "spec": {
        "role": "robot", "observation_size": 34, "action_size": 7, "torso": "mlp",
        "hidden": [128, 128],
        "activation": "tanh", "squash": "clip", "std": "parameter", "normalise": True,
    },
    "self_play": {"mean": 999.11, "iqm": 996.7, "mean_ci": [994.6, 1003.6], "n": 64,
                  "success": 1.0},
    "training": {"run": "r", "seed": 5, "steps": 1000, "device": None,
                 "versions": {"jax": "0.10.2"}},
    "splits": {"scratch/half-s0-v0-f4c7b97d": "train"},
    "sha256": "a" * 64,
}  # fmt: skip
HUMAN = {
    **CARD,
    "id": "scratch/ippo-d3-s5-v0/human",
    "spec": {**CARD["spec"], "role": "human"},
    "sha256": "b" * 64,
}


def test_team_card_has_all_that_is_known() -> None:
    text = markdown_card([CARD, HUMAN], "pictures/robot at work.png")
    assert text.split("---\n")[2].startswith(
        "# scratch/ippo-d3-s5-v0\n\n![scratch/ippo-d3-s5-v0](<pictures/robot at work.png>)\n"
    )
    facts = ("strength 0.4", "999.1, 95% interval 994.6 to 1003.6 over 64", "128, 128")
    use = "evaluate zoo:scratch/ippo-d3-s5-v0/robot"
    for words in (*facts, "| versions.jax | 0.10.2 |", "f4c7b97d | train", "a" * 64, "b" * 64, use):
        assert words in text
    assert "None" not in text


def test_a_policy_s_card_stands_alone_and_unmeasured() -> None:
    text = markdown_card([{**CARD, "self_play": None, "splits": {}}])
    assert text.split("---\n")[2].startswith("# scratch/ippo-d3-s5-v0/robot\n\n|")
    assert "not measured" in text and "human" not in text and "--split test --out" in text


def test_card_command_names_partners_of_robots_version() -> None:
    """The default split may be of another release, whose partners it cannot play with."""
    against = {"split": "scratch/persons-s0-v1-8ed93cbc", "sha256": "c" * 64}
    assert f"--split {next(iter(CARD['splits']))} --out" in markdown_card([CARD])
    trained = {**CARD, "trained_against": against}
    assert f"--split {against['split']} --out" in markdown_card([trained])


def test_a_robot_s_card_has_its_m_test() -> None:
    m_test = {"mean": 448.8, "mean_ci": (304.9, 569.3), "n": 8, "split": "scratch/persons-s0-v1-1"}
    text = markdown_card([{**CARD, "self_play": None, "m_test": m_test}])
    assert "| M_test | 448.8, 95% interval 304.9 to 569.3, with 8 partners of the test side" in text
    data = ModelCard(text).data
    assert isinstance(data, ModelCardData)
    [found] = data.eval_results or []
    assert (found.metric_name, found.metric_value) == ("M_test", 448.8)
    assert found.dataset_name == m_test["split"]


@pytest.mark.parametrize("figures", [CARD["self_play"], None])
def test_a_hub_reads_the_card(figures: dict[str, Any] | None) -> None:
    card = ModelCard(markdown_card([{**CARD, "self_play": figures}]))
    assert isinstance(card.data, ModelCardData)
    assert (card.data.license, card.data.pipeline_tag) == ("apache-2.0", "reinforcement-learning")
    results = [(entry.metric_type, entry.metric_value) for entry in card.data.eval_results or []]
    assert results == ([("mean_reward", 999.11)] if figures else [])


def test_text_from_elsewhere_stays_in_its_cell() -> None:
    training = {"run": "a | b\n# heading <script>", "seed": 1}
    text = markdown_card([{**CARD, "training": training}], "x>)<img>\n.png")
    assert "| run | a \\| b # heading &lt;script> |" in text and "(<x)img.png>)" in text


def test_remote_card_has_newest_figures(registry: Registry, team, publish_to) -> None:
    assert "| scratch | ippo | d1 | 4 | " in model_card(registry, "org/zoo")
    candidate = dataclasses.replace(
        team("ippo", "d1", 0), self_play={"mean": 7.0, "iqm": 7.0, "mean_ci": [6.0, 8.0], "n": 16}
    )
    text = model_card(publish_to([candidate], registry.path, release="v1"), "org/zoo")
    assert "| scratch | ippo | d1 | 1 | 7.0 |" in text and "| scratch | ippo | d9 | 4 | " in text
