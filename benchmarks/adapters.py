"""Speed of the vector adapters, compared with the bare environment and a single simulation."""

import dataclasses
import os
import statistics
from collections.abc import Callable
from typing import Any

import numpy as np

from assistax_zoo.shell.console import print_json, stdout_is_data
from benchmarks.timing import check_seconds

PARTNERS = ("split", "persons", "nobody")


@dataclasses.dataclass(frozen=True)
class AdapterSpeed:
    """Speed of Gymnasium's vector form with NumPy arrays and random actions, and two comparisons.

    Ratios are medians of neighbouring runs, so that they hold on a machine that others use too.
    """

    task: str
    backend: str
    partners: str  # one of PARTNERS
    num_envs: int
    env_steps_per_second: float  # median of the repeats
    repeats: tuple[float, ...]
    of_bare: float  # ratio to the environment alone, open loop in one program
    of_single: float  # ratio to Gymnasium's adapter of one simulation
    steps: int  # of every simulation in each repeat
    load: tuple[float, float]  # average of a minute, before and after
    device: str


def adapters(
    *,
    task: str = "gentle_scratch",
    partners: str = "split,persons,nobody",
    num_envs: int = 512,
    backend: str = "auto",
    seconds: float = 5.0,
    json: bool = False,
) -> None:
    """Measure Gymnasium's vector form in turns with the bare environment and a batch of one.

    Args:
        task: Task.
        partners: Partners in the human's seats: split, persons, nobody; several with commas.
        num_envs: Simulations.
        backend: fused, native, mjx, mjx-warp or auto.
        seconds: Measuring time of each vector form, about.
        json: Print JSON.

    Example:
        python -m benchmarks adapters --task gentle_scratch --num-envs 512
    """
    check_seconds(seconds)
    chosen = [word.strip() for word in partners.split(",")]
    if unknown := set(chosen) - {*PARTNERS}:
        raise ValueError(f"partners is {min(unknown)!r}; allowed are {', '.join(PARTNERS)}")
    with stdout_is_data():
        rows = [measure_adapter(task, who, num_envs, backend, seconds) for who in chosen]
    if json:
        print_json([dataclasses.asdict(row) for row in rows])
        return
    for row in rows:
        print(
            f"{row.task} with {row.partners:8} {row.num_envs} simulations on {row.backend}: "
            f"{row.env_steps_per_second:9,.0f} env steps/s ({min(row.repeats):,.0f} to "
            f"{max(row.repeats):,.0f}), {row.of_bare:.2f} of the bare environment, "
            f"{row.of_single:,.0f} times a batch of one; load {row.load[0]:.1f} to "
            f"{row.load[1]:.1f}, {row.device}"
        )


def measure_adapter(
    task: str, partners: str, num_envs: int, backend: str, seconds: float
) -> AdapterSpeed:
    """Return the speed of one vector form; compilation is not counted."""
    import jax

    from assistax_envs import make
    from assistax_envs.adapters.gymnasium import AssistaxEnv, AssistaxVectorEnv
    from assistax_zoo.vector_envs import vector_env
    from benchmarks.simulation import CALL, device_name, open_loop
    from benchmarks.timing import REPEATS, calls_within, timed

    load = os.getloadavg()[0]
    if partners == "nobody":
        env = AssistaxVectorEnv(task, num_envs, backend=backend)
    else:
        who = None if partners == "split" else partners
        env = vector_env(task, num_envs, partners=who, backend=backend)
    rng = np.random.default_rng(0)
    vector, single = _stepper(env, rng), _stepper(AssistaxEnv(task), rng)
    bare_env = make(task, backend)
    bare = open_loop(bare_env, num_envs)
    jax.block_until_ready(bare(1))
    calls = max(calls_within(vector, seconds / REPEATS), CALL)
    runs = []
    for _ in range(REPEATS):
        times = timed(vector, calls), timed(bare, calls // CALL), timed(single, CALL)
        runs.append((num_envs * calls / times[0], num_envs * (calls // CALL) * CALL / times[1],
                     CALL / times[2]))  # fmt: skip
    speeds = tuple(run[0] for run in runs)
    return AdapterSpeed(
        task=task,
        backend=bare_env.backend,
        partners=partners,
        num_envs=num_envs,
        env_steps_per_second=statistics.median(speeds),
        repeats=speeds,
        of_bare=statistics.median(run[0] / run[1] for run in runs),
        of_single=statistics.median(run[0] / run[2] for run in runs),
        steps=calls,
        load=(load, os.getloadavg()[0]),
        device=device_name(bare_env.backend),
    )


def _stepper(env: Any, rng: np.random.Generator) -> Callable[[int], None]:
    """Return a compiled function that takes steps of random actions."""
    actions = rng.uniform(-1.0, 1.0, (16, *env.action_space.shape)).astype(np.float32)
    env.reset(seed=0)

    def run(steps: int) -> None:
        for step in range(steps):
            env.step(actions[step % len(actions)])

    run(1)
    return run
