"""Who plays for the gates is trained, and an audit reads the folders that this leaves."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_workshop.auditing import audit
from assistax_workshop.gates.training import CONDITIONS, OneEach, train_conditions
from assistax_zoo.shell.main import run
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack

TINY = {"num_envs": 4, "rollout_steps": 8, "minibatches": 1, "epochs": 1, "hidden": (8, 8)}


@pytest.mark.slow
def test_audit_reads_the_trained_conditions(tmp_path: Path) -> None:
    train_conditions(
        "gentle_lift",
        tmp_path,
        ("teams", "told", "passive", "response", "ego", "ego-told", "ego-recurrent"),
        seeds=(100, 101),
        steps=32,
        changes=TINY,
        backend="native",
    )
    names = ("told", "response", "ego", "ego_told", "ego_recurrent")
    runs = {name: str(tmp_path / name.replace("_", "-")) for name in names}
    runs["passive_robot"] = str(tmp_path / "passive")
    audited = audit("gentle_lift", str(tmp_path / "teams"), **runs, episodes=2, progress=False)
    assert audited.teams == ("teams/ippo-d1-s100/robot", "teams/ippo-d1-s101/robot")
    played = {"passive robot, teams' humans", "told", "best responses"}
    assert played < set(audited.figures)
    assert audited.figures["best responses"]["episodes"] == 4  # each with the human it was made for
    egos = [audited.figures[f"ego{kind}"]["episodes"] for kind in ("", " told", " recurrent")]
    assert egos == [4, 4, 4]  # two robots with the human of the second team alone


@pytest.mark.slow
def test_only_the_told_see_the_preference(tmp_path: Path) -> None:
    widths = {}
    for name in ("teams", "told"):
        train_conditions(
            "gentle_scratch", tmp_path, (name,), seeds=(0,), steps=32, changes=TINY,
            backend="native",
        )  # fmt: skip
        assert (tmp_path / name / "teams.json").is_file()
        metrics = pl.read_parquet(tmp_path / name / "metrics.parquet")
        assert metrics["seed"].unique().to_list() == [0]
        widths[name] = (tmp_path / name / "robot.safetensors").stat().st_size
    assert widths["told"] > widths["teams"]
    assert CONDITIONS["told"].told == ("human", "robot")


def test_each_best_response_meets_its_own_partner_alone() -> None:
    policy = Policy(PolicySpec("human", 3, 2, hidden=(4,)))
    params = jax.vmap(policy.init)(jax.random.split(jax.random.key(0), 2))
    params = jax.tree.map(
        lambda leaf: leaf + 0.1 * jnp.arange(leaf.size).reshape(leaf.shape), params
    )
    stack = PolicyStack(policy.spec, ("a", "b"), jax.tree.map(np.asarray, params))
    partners = OneEach([stack], dict.fromkeys(stack.ids, DISABILITY_SETTINGS["d1"]))
    obs, first = jnp.ones((6, 3)), jnp.zeros(6, bool)
    carry = partners.initial_carry(6)
    _, actions = partners.act(partners.params, carry, obs, first, members=2)
    for row in range(2):
        own = jax.tree.map(lambda leaf, row=row: leaf[row], params)
        expected = policy.act(own, (), obs[:3], first[:3])[1]
        np.testing.assert_allclose(actions[3 * row : 3 * row + 3], expected, atol=1e-6)
    assert not np.allclose(actions[0], actions[3])


def test_an_unknown_condition_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["gates", "train", "gentle_lift", str(tmp_path), "--only", "hopeful"]
    assert run([*words, "--set", "num_envs=4"]) == 1
    assert "condition is 'hopeful'; allowed are teams, mappo" in capsys.readouterr().err
