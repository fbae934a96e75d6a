"""Training learns the real task: IPPO on scratch."""

import json

import polars as pl
import pytest

from assistax_envs import make
from population.config import Member, TrainConfig
from population.hyperparameters import preset
from population.runs.train import train

# Of each member, with the tables' hyperparameters but few simulations: 48 updates, after which the
# return hardly rises any more, so that a processor's last bits do not matter.
STEPS = 393_216


@pytest.mark.slow
def test_ippo_learns_to_scratch(tmp_path):
    """The second member is the start and the planted defect: its learning rate is 0."""
    members = (Member(0, "d1"), Member(0, "d1", {"learning_rate": 0.0}))
    trainer = preset("ippo", num_envs=128, rollout_steps=64)
    config = TrainConfig(
        "scratch", "ippo", members, STEPS, trainer, checkpoint_every=1000, self_play_episodes=4
    )
    run = train(config, make("scratch", backend="native"), tmp_path / "run")
    metrics = pl.read_parquet(run / "metrics.parquet")
    rows = [metrics.filter(member=member)["return"].drop_nulls() for member in (0, 1)]
    learned, start = (returns.to_numpy()[-3:].mean() for returns in rows)
    teams = json.loads((run / "teams.json").read_text())
    played, idle = (team["self_play"]["mean"] for team in teams)
    assert learned > max(400.0, 3.0 * start)
    # Without exploration doing nothing earns more than trembling.
    assert played > max(400.0, 2.0 * idle)
    assert max(start, idle) < 400.0
