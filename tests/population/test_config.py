import json

import pytest

from population.config import Member as TeamMember
from population.config import TrainConfig, make_members
from population.hyperparameters import preset

# The paper's hyperparameters, as its tables print them.
PAPER = {
    "ippo": {
        "rollout_steps": 64, "num_envs": 1024, "epochs": 4, "minibatches": 4, "gamma": 0.99,
        "learning_rate": 1e-3, "anneal_lr": False, "entropy_coef": 1e-4, "clip_eps": 0.31,
        "gae_lambda": 0.95, "value_coef": 1.0, "max_grad_norm": 0.5, "adam_eps": 1e-8,
        "critic": "local", "hidden": (128, 128),
    },
    "mappo": {
        "rollout_steps": 128, "num_envs": 1024, "epochs": 4, "minibatches": 4, "gamma": 0.99,
        "learning_rate": 4.4e-3, "anneal_lr": False, "entropy_coef": 2.7e-4, "clip_eps": 0.11,
        "gae_lambda": 0.95, "value_coef": 1.0, "max_grad_norm": 0.5, "adam_eps": 1e-8,
        "critic": "central", "hidden": (128, 128),
    },
}  # fmt: skip


@pytest.mark.parametrize("algorithm", PAPER)
def test_presets_are_the_papers(algorithm):
    config = preset(algorithm)
    assert {name: getattr(config, name) for name in PAPER[algorithm]} == PAPER[algorithm]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_envs": 10, "minibatches": 4}, "multiple of minibatches"),
        ({"learning_rate": -1.0}, "learning_rate is -1.0; it must be greater than 0"),
        ({"learning_rate": float("nan")}, "learning_rate is nan; it must be a finite number"),
        ({"gamma": 1.5}, "gamma is 1.5; it must be less than or equal to 1"),
        ({"torso": "lstm"}, "torso is 'lstm'; it must be 'mlp' or 'gru'"),
        ({"rollout_steps": 0}, "rollout_steps is 0"),
        ({"learning_rate": "fast"}, "learning_rate is 'fast'; it must be a valid number"),
        ({"gamma": "x"}, "gamma is 'x'; it must be a valid number"),
        ({"normalise": "no"}, "normalise is 'no'; it must be a valid boolean"),
        ({"hidden": 64}, "hidden is 64; it must be a valid tuple"),
        ({"hidden": ()}, "should have at least 1 item"),
        ({"hidden": (8, True)}, "hidden.1 is True; it must be a valid integer"),
        ({"epochs": True}, "epochs is True; it must be a valid integer"),
        ({"initial_log_std": 2}, "initial_log_std is 2; it must be less than or equal to 1"),
        ({"speed": 1}, "unknown hyperparameter speed of ippo; allowed are"),
    ],
)
def test_bad_hyperparameters_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        preset("ippo", **changes)


def test_train_config_survives_json():
    members, trainer = (TeamMember(3, "d1", {"gamma": 0.9}),), preset("ippo", num_envs=1024)
    config = TrainConfig("scratch", "ippo", members, 65_537, trainer)
    assert config.updates == 2  # steps are rounded up
    assert TrainConfig.from_json(json.loads(json.dumps(config.to_json()))) == config


@pytest.mark.parametrize(
    ("members", "message"),
    [
        (make_members([0, 0], ["d1"]), "two members of a run are identical"),
        ((TeamMember(0, "d1", {"epochs": 2}),), "overrides epochs; members may differ in learning"),
    ],
)
def test_wrong_members_are_refused(members, message):
    with pytest.raises(ValueError, match=message):
        TrainConfig("scratch", "ippo", members, 1000)
