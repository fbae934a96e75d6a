"""The gates of a task: their arithmetic by hand, and every condition on a tiny budget."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from assistax_base.errors import ZooError
from assistax_envs import disability_params, make
from assistax_envs.preferences import PREFERENCES, PREFERRED, VALUES
from assistax_workshop.gates import audit as audits
from assistax_workshop.gates.audit import WrongBeliefEnv
from assistax_workshop.gates.audit_gates import Gate, gates_of
from assistax_zoo.shell.main import run
from population.config import TrainConfig, make_members
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from population.runs.folder import RunFolder
from tests.envs.conftest import one_gentle_task
from tests.evaluation.episode_tables import Team, episode_table, teams
from tests.untrained import params_of

TASK = "gentle_lift"
TOUCH = {"contact steps below the limit": 0.995, "joint speed, share of the limit": 0.5}
TWO: list[Team] = teams(2)


def played(returns: Any, egos: Any = TWO, partners: Any = TWO, **columns: Any) -> pl.DataFrame:
    """Episodes of returns [E, P, K], all of which reached the goal and hurt nobody."""
    table = episode_table(np.array(returns, float), egos, partners)
    safe = {"success": True, "violated": False, **columns}
    return table.with_columns(pl.lit(value).alias(name) for name, value in safe.items())


def own_of(pairs: pl.DataFrame) -> pl.DataFrame:
    return pairs.filter(pl.col("ego_team") == pl.col("partner_team"))


def gates(**changes: pl.DataFrame) -> dict[str, Gate]:
    """Teams that earn 100 with their own and 50 with the other's human."""
    pairs = played([[[100.0] * 4, [50.0] * 4], [[50.0] * 4, [100.0] * 4]])
    idle = played([[[10.0] * 4]], ["script"], TWO[:1], success=False)
    pairs = changes.get("all pairs", pairs)
    conditions = {
        "own teams": own_of(pairs),
        "all pairs": pairs,
        "script, passive human": idle,
        "script, human held": idle,
        **changes,
    }
    return {gate.gate: gate for gate in gates_of(TASK, conditions, TOUCH)}


def test_gates_by_hand() -> None:
    by_name = gates()
    assert by_name["script with a passive human"].value == 0.0
    assert by_name["script with a passive human"].holds
    assert by_name["teams reach the goal"].value == 1.0 and by_name["teams hurt nobody"].holds
    assert by_name["cross-play between seeds"].value == pytest.approx(0.5)
    assert by_name["contact steps below 32.5 N"].holds
    assert by_name["fastest joint, share of the datasheet's"].holds
    missing = [name for name, gate in by_name.items() if gate.holds is None]
    assert [by_name[name].told.rpartition("needs ")[2] for name in missing] == [
        *("a passive robot", "a passive robot", "a response to each team", "told teams"),
        *("recurrent teams", "egos, and egos that are told", "a gentle task", "blind teams"),
    ]
    # It would read as not measured.
    with pytest.raises(ValueError, match="'mistaken human' is not a valid Condition"):
        gates(**{"mistaken human": played([[[80.0] * 4] * 2] * 2)})


@pytest.mark.parametrize(
    ("condition", "gate", "earned", "value", "holds"),
    [
        ("told", "teams whose robot is told the preference", 110.0, 1.1, True),
        ("told", "teams whose robot is told the preference", 104.0, 1.04, False),
        ("recurrent", "teams whose robot remembers", 101.0, 1.01, True),
        ("mistaken humans", "humans that believe in another preference", 80.0, 0.2, True),
        ("mistaken humans", "humans that believe in another preference", 100.0, 0.0, False),
        ("blind", "control: humans that were never told theirs", 90.0, 0.1, True),
        ("best responses", "best response to a frozen partner", 79.0, 0.79, False),
        ("passive robot, passive human", "robot trained with a passive human", 70.0, 0.3, True),
        ("passive robot, passive human", "robot trained with a passive human", 85.0, 0.15, False),
    ],
)
def test_other_conditions_are_shares_of_what_teams_earn(
    condition: str, gate: str, earned: float, value: float, holds: bool
) -> None:
    pairs = played([[[earned] * 4, [0.0] * 4], [[0.0] * 4, [earned] * 4]])
    gate_found = gates(**{condition: own_of(pairs)})[gate]
    assert gate_found.value == pytest.approx(value) and gate_found.holds == holds
    assert gate_found.ci == pytest.approx((value, value))  # nobody differs


def test_ego_gates_value_knowledge_and_memory() -> None:
    def earned(*returns: float) -> pl.DataFrame:
        return played([[[value] * 4] * 2 for value in returns], ["one", "other"], TWO)

    some = {"ego": earned(90.0, 110.0), "ego told": earned(125.0, 115.0)}
    worth, won_back = list(gates(**some, **{"ego recurrent": earned(105.0, 105.0)}).values())[10:12]
    assert worth.value == pytest.approx(1.2) and worth.holds
    assert won_back.value == pytest.approx(0.25)
    assert won_back.ci is not None and won_back.ci[0] < 0.0 and not won_back.holds
    known = gates(**some, **{"ego recurrent": earned(115.0, 119.0)})
    assert known["share of that which a recurrent robot wins back"].holds
    assert "not measured: needs recurrent egos" in [gate.told for gate in gates(**some).values()]


def test_capable_script_and_violent_teams_fail_their_gates() -> None:
    """Planted: the two things that an audit is for."""
    able = played([[[90.0] * 4]], ["script"], TWO[:1])
    assert not gates(**{"script, passive human": able})["script with a passive human"].holds
    rough = played([[[100.0] * 4, [50.0] * 4], [[50.0] * 4, [100.0] * 4]], violated=True)
    by_name = gates(**{"all pairs": rough})
    assert not by_name["teams hurt nobody"].holds


def test_best_posture_is_chosen_on_other_episodes() -> None:
    """Planted: one posture is lucky in the even episodes, and no good in the odd ones."""
    held = played([[[99.0, 0.0, 99.0, 0.0], [50.0] * 4]], ["script"], TWO)
    lucky = held.with_columns(success=pl.col("return") > 40.0)
    gate = gates(**{"script, human held": lucky})["script with the human in its best fixed posture"]
    assert gate.value == 0.0


def test_intervals_widen_with_the_teams() -> None:
    four = teams(4)
    returns = np.zeros((4, 4, 2))
    for i, value in enumerate((60.0, 90.0, 110.0, 140.0)):
        returns[i, i] = value
    pairs = played(returns, four, four)
    own = pairs.filter(pl.col("ego_team") == pl.col("partner_team"))
    found = gates(**{"all pairs": pairs, "told": own, "mistaken humans": own})
    told, paired = (
        found["teams whose robot is told the preference"],
        found["humans that believe in another preference"],
    )
    assert told.value == pytest.approx(1.0) and told.ci is not None
    assert told.ci[0] < 0.85 and told.ci[1] > 1.15
    assert paired.ci == pytest.approx((0.0, 0.0))  # each team beside itself
    # Own teams play more episodes; what happens in those that the other has not is no loss of its.
    rare = own.with_columns(pl.col("return") - 900.0, pl.col("episode") + 2)
    more = {"all pairs": pairs, "own teams": pl.concat([own, rare]), "mistaken humans": own}
    same = gates(**more)["humans that believe in another preference"]
    assert (same.value, same.ci) == (paired.value, paired.ci)


@pytest.mark.slow
@one_gentle_task
def test_mistaken_human_observes_the_next_preference(task: str) -> None:
    env = make(task, "native")
    wrong, keys = WrongBeliefEnv(env), jax.random.split(jax.random.key(0), 9)
    params = disability_params(["d1"] * 9, list(PREFERENCES))
    first, other = (jax.jit(environment.reset)(keys, params) for environment in (env, wrong))
    jax.tree.map(np.testing.assert_array_equal, first.task.preference, other.task.preference)
    np.testing.assert_array_equal(first.obs["robot"], other.obs["robot"])
    count = len(PREFERRED[task])
    np.testing.assert_array_equal(first.obs["human"][:, :-count], other.obs["human"][:, :-count])
    for column, wish in enumerate(PREFERRED[task], start=-count):
        values = VALUES[wish]
        for row, liked in enumerate(PREFERENCES.values()):
            believed = values[1] * np.exp(float(other.obs["human"][row, column]))
            at = values.index(getattr(liked, wish))
            assert believed == pytest.approx(values[(at + 1) % 3], rel=1e-4)
    still = {"robot": jnp.zeros((9, 7)), "human": jnp.zeros((9, 3))}
    after = jax.jit(wrong.step)(other, still)
    np.testing.assert_allclose(after.obs["human"][:, -count:], other.obs["human"][:, -count:])


def trained(folder: Path, observers: tuple[str, ...] = ("human",), seeds: int = 2) -> Path:
    """Return a finished run of teams that learned nothing."""
    env = make(TASK, "native", told=observers)
    config = TrainConfig(TASK, "ippo", make_members(tuple(range(seeds)), ("d1",)), steps=10)
    specs = {
        role: PolicySpec(role, env.observation_size[role], env.action_size[role], hidden=(4,))
        for role in ("robot", "human")
    }
    params = {
        role: jax.tree.map(
            lambda *leaves: np.stack(leaves), *(params_of(spec, s) for s in range(seeds))
        )
        for role, spec in specs.items()
    }
    training = {"steps": 10, "env_version": 1, "backend": "native"}
    folder.mkdir()
    RunFolder(folder).write_teams(config, specs, params, training, [None] * seeds)
    return folder


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes of ten steps, and one posture: the mechanics alone."""
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 10)
    monkeypatch.setattr(audits, "HELD", audits.HELD[:1])


@pytest.mark.parametrize(("torques", "count"), [(3, 27), (5, 243)])
def test_held_roster_has_every_posture(torques: int, count: int) -> None:
    """Whatever it observes, it gives its own torques, and no two give the same."""
    roster = audits.held_roster(4, torques)
    assert len(roster.ids) == count
    [stack] = roster.stacks
    assert isinstance(stack, PolicyStack)
    policy, seen = Policy(stack.spec), jnp.ones((count, 1, 4))
    carry = policy.initial_carry((count, 1))
    _, acted = jax.vmap(policy.act)(stack.params, carry, seen, jnp.zeros((count, 1), bool))
    assert len({tuple(row) for row in np.asarray(acted)[:, 0].tolist()}) == count


@pytest.mark.slow
def test_an_audit_of_run_folders(
    tmp_path: Path, short: None, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = {
        "team": trained(tmp_path / "own"),
        "passive-robot": trained(tmp_path / "alone", seeds=1),
        "response": trained(tmp_path / "answers"),
        "told": trained(tmp_path / "told", ("robot", "human")),
        "blind": trained(tmp_path / "blind", ()),
        "recurrent": trained(tmp_path / "recurrent"),
    }
    words = [word for name, path in runs.items() for word in (f"--{name}", str(path))]
    options = ["--episodes", "2", "--backend", "native", "--out", str(tmp_path / "out")]
    assert run(["audit", TASK, *words, *options]) == 0
    printed = capsys.readouterr().out  # cells are folded
    assert "cross-play" in printed and "own, step by step: contact steps" in printed
    result = az.audit(
        TASK, str(runs["team"]), episodes=2, backend="native", out=tmp_path / "out", progress=False
    )
    assert result.teams == ("own/ippo-d1-s0/robot", "own/ippo-d1-s1/robot")
    assert result.figures["own teams"]["episodes"] == 40  # ten times as many
    assert {"success", "violated", "contact_peak"} <= set(result.figures["strangers"])
    assert "mistaken humans" in result.figures and "told" not in result.figures


def test_bad_audits_are_refused_in_one_line(tmp_path: Path) -> None:
    own = str(trained(tmp_path / "own"))
    with pytest.raises(ValueError, match="give at least 2"):
        az.audit(TASK, own, episodes=1, progress=False)
    with pytest.raises(ValueError, match=f"own is of task {TASK}; give teams of gentle_bath"):
        az.audit("gentle_bath", own, progress=False)
    with pytest.raises(ValueError, match="1 best responses for 2 teams; give one for each"):
        az.audit(TASK, own, response=str(trained(tmp_path / "one", seeds=1)), progress=False)
    with pytest.raises(ZooError, match="unknown policy 'gentle_lift/nobody-"):
        az.audit(TASK, f"{TASK}/nobody-*", progress=False)
