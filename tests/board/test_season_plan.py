"""`season plan`: secret seeds for a public plan, and the way from there to a season."""

import dataclasses
import json
import zlib
from pathlib import Path
from typing import Any

import jax
import pytest

from assistax_base.errors import IdError
from assistax_board.serve import open_service
from assistax_workshop.plans.plan import SECRET_SEEDS, Group, Plan, private_plan, read_plan
from assistax_zoo.shell.main import run
from population.config import Member
from population.runs.train import member_key
from tests.workshop.test_population_command import ONE, OTHER, use_toy, write_plan
from zoo.ids import parse_team
from zoo.registry import load_registry

PAPER = Path(__file__).parents[2] / "zoo" / "plans" / "paper.json"
GENTLE = {
    "version": 1,
    "release": "v0",
    "groups": [
        {
            "name": f"{task}-{algorithm}",
            "task": task,
            "algorithm": algorithm,
            "disabilities": ["d1", "d3", "d7", "d9"],
            "seeds": 3,
            "steps": 20_000_000,
            "set": {"num_envs": 256, "initial_log_std": -1.2},
        }
        for task in ("gentle_scratch", "gentle_bath")
        for algorithm in ("ippo", "mappo", "mep")  # the last trains populations
    ],
}


@pytest.fixture
def gentle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of gentle tasks, some of whose teams are populations."""
    path = tmp_path_factory.mktemp("public") / "gentle.json"
    path.write_text(json.dumps(GENTLE))
    return path


def make(out: Path, *more: str, plan: Path) -> Path:
    assert run(["season", "plan", str(plan), "--out", str(out), *more]) == 0
    return out


def seeds_of(plan: Plan) -> list[int]:
    return [seed for group in plan.groups for seed in group.seeds]


@pytest.mark.parametrize("name", ["paper", "gentle"])
def test_all_but_the_seeds_is_the_public_plans(tmp_path: Path, name: str, gentle: Path) -> None:
    plan = PAPER if name == "paper" else gentle
    public, private = read_plan(plan), read_plan(make(tmp_path / "plan.json", plan=plan))
    again = read_plan(make(tmp_path / "again.json", plan=plan))
    seeds = seeds_of(private)
    assert len(set(seeds)) == len(seeds) == len(seeds_of(public))
    assert set(seeds).isdisjoint(seeds_of(public)) and set(seeds) != set(seeds_of(again))
    assert SECRET_SEEDS.stop - SECRET_SEEDS.start > 2**62 and all(s in SECRET_SEEDS for s in seeds)
    assert max(seeds) > 2**60, "all are lower with a chance below 2 to the power of -54"
    assert not any(group.adopt for group in private.groups)
    groups = [
        dataclasses.replace(group, seeds=known.seeds, adopt=known.adopt)
        for group, known in zip(private.groups, public.groups, strict=True)
    ]
    assert dataclasses.replace(private, groups=tuple(groups)) == public


def test_a_draw_of_public_seeds_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    class Counting:
        def sample(self, population: range, k: int) -> range:
            return population[:k]

    monkeypatch.setattr("assistax_workshop.plans.plan.secrets.SystemRandom", Counting)
    first = 2**31  # of the seeds that are drawn
    public = Group(**{**OTHER, "seeds": [first, first + 2]})
    private = private_plan(Plan(version=1, release="v1", groups=(Group(**ONE), public)))
    expected = [(first + 1, first + 3), (first + 4, first + 5)]
    assert [group.seeds for group in private.groups] == expected


def test_every_seed_bit_changes_training() -> None:
    """JAX alone would keep 32 of them: a guess of the lower half would be enough."""
    keys = {
        seed: key_of(seed) for seed in (5, 2**31 + 5, 2**32 + 5, 2**62 + 5, 2**63 - 1, 2**31 - 1)
    }
    assert len(set(keys.values())) == len(keys)
    settled = jax.random.fold_in(jax.random.key(5), zlib.crc32(b"d1"))
    assert keys[5] == tuple(jax.random.key_data(settled).tolist()), "published teams train again"
    team = f"scratch/ippo-d1-s{2**63 - 1}-v1"
    assert str(parse_team(team)) == team
    with pytest.raises(IdError):
        parse_team(f"scratch/ippo-d1-s{2**63}-v1")


def key_of(seed: int) -> tuple[int, ...]:
    return tuple(jax.random.key_data(member_key(Member(seed, "d1"))).tolist())


def test_smaller_plan_has_fewer_seeds(
    tmp_path: Path, gentle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = ("--task", "gentle_scratch")
    private = read_plan(make(tmp_path / "plan.json", *task, "--teams", "30", plan=gentle))
    public = {group.name: group for group in read_plan(gentle).groups}
    assert 16 <= sum(len(group.members) for group in private.groups) <= 30
    for group in private.groups:
        assert group.disabilities == public[group.name].disabilities
        fewest = 2 if group.trainer.population_coef else 1
        assert fewest <= len(group.seeds) <= len(public[group.name].seeds)
    words = ["season", "plan", str(gentle), "--out", str(tmp_path / "x"), *task, "--teams", "9"]
    assert run(words) == 1
    assert "every group needs a seed, which is 16 teams" in capsys.readouterr().err


def test_private_plan_is_private_and_minimal(tmp_path: Path, gentle: Path) -> None:
    words = ("--task", "gentle_bath", "--release", "v7")
    path = make(tmp_path / "private" / "plan.json", *words, plan=gentle)
    assert path.stat().st_mode & 0o777 == 0o600 and path.parent.stat().st_mode & 0o077 == 0
    private, public = read_plan(path), read_plan(gentle)
    expected = [group.name for group in public.groups if group.task == "gentle_bath"]
    assert private.release == "v7" and [group.name for group in private.groups] == expected
    path = make(tmp_path / "minimal.json", "--task", "scratch", plan=PAPER)
    group = json.loads(path.read_text())["groups"][0]
    assert group.keys() == {
        *("name", "task", "algorithm", "disabilities", "seeds", "steps"),
        *("updates_per_call", "checkpoint_every"),
    }


@pytest.mark.parametrize(
    ("out", "more", "message"),
    [
        ("new/plan.json", ["--task", "swim"], "task is 'swim'; the plan has gentle_scratch, "),
        ("new/plan.json", ["--release", "spring"], "release is 'spring'"),
        ("old.json", [], "old.json exists"),
    ],
)
def test_invalid_plan_gets_one_error(
    tmp_path: Path,
    gentle: Path,
    capsys: pytest.CaptureFixture[str],
    out: str,
    more: list[str],
    message: str,
) -> None:
    (tmp_path / "old.json").write_text("{}")
    assert run(["season", "plan", str(gentle), "--out", str(tmp_path / out), *more]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["old.json"]
    assert (tmp_path / "old.json").read_text() == "{}"


@pytest.mark.slow
def test_from_a_plan_to_a_season(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The commands of docs/service.md, on a toy; the public plan's own partners are refused."""
    use_toy(monkeypatch)
    write_plan(tmp_path, {**ONE, "disabilities": ["d1", "d9"]})
    public, private = tmp_path / "public", tmp_path / "private"
    train(tmp_path / "plan.json", public)
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(public / "registry.json"))
    open_service(tmp_path / "board")

    train(make(private / "plan.json", plan=tmp_path / "plan.json"), private)
    entries = load_registry(private / "registry.json").select(role="human")
    assert {entry.seed for entry in entries} == {*seeds_of(read_plan(private / "plan.json"))}
    assert run(create(tmp_path, public)) == 1
    assert "is public; a private release has only new partners" in capsys.readouterr().err
    assert run(create(tmp_path, private)) == 0


def train(plan: Path, folder: Path) -> None:
    words: list[Any] = ["--plan", plan, "--out", folder / "runs"]
    words += ["--registry", folder / "registry.json"]
    assert run(["train", "population", *map(str, words)]) == 0


def create(place: Path, release: Path) -> list[str]:
    words = ["season", "create", "spring", "--task", "scratch", "--small"]
    return [*words, "--release", str(release), "--data", str(place / "board")]
