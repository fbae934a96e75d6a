"""Tiny teams of a rehearsal, trained by the commands that train a release."""

import contextlib
from pathlib import Path
from typing import Any

TINY = {"num_envs": 4, "rollout_steps": 8, "minibatches": 2, "epochs": 1, "hidden": [8, 8]}
MEMBERS = {"disabilities": ("d1", "d9"), "seeds": 2, "steps": 32, "self_play_episodes": 1}


def train_teams(folder: Path, task: str, backend: str, *, hidden: bool) -> int:
    """Train and publish teams to the registry of a folder; return how many there are.

    Args:
        folder: New folder of plan, runs and registry.
        task: The task.
        backend: Backend that trains.
        hidden: Whether the plan is a private one, with secret seeds.

    Raises:
        ValueError: A training failed.
    """
    from assistax_workshop.plans.plan import Group, private_plan, write_private_plan
    from assistax_workshop.plans.plan import Plan as TrainingPlan
    from assistax_workshop.plans.training import PlanTraining

    fields: dict[str, Any] = {**MEMBERS, "set": TINY}
    group = Group(name="rehearsal", task=task, algorithm="ippo", **fields)
    plan = TrainingPlan(version=1, release="v0", groups=(group,))
    path = folder / "plan.json"
    if hidden:
        plan = private_plan(plan)
        write_private_plan(plan, path)
    training = PlanTraining(
        plan=plan,
        groups=list(plan.groups),
        path=path,
        out=folder / "runs",
        registry=folder / "registry.json",
        backend=backend,
        shown=lambda _: contextlib.nullcontext(lambda _: None),
    )
    training.do(train=True, publish=True, curves=None)
    if training.errors:
        raise ValueError("; ".join(training.errors.values()))
    return sum(len(group.members) for group in plan.groups)
