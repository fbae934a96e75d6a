"""Prints what it costs that nothing is contracted into fused multiply-adds.

    python -m tests.envs.fused.contraction

Control steps of 1,152 trained teams' states of the scratch scene, on all cores, interleaved.
"""

import time

import numpy as np

from tests.envs.fused.scenes import Engine, States, scene, team_states

REPEATS = 15


def main() -> None:
    states, ranges = team_states("scratch")
    states = States(*(np.tile(x, (4, 1)) for x in (states.qpos, states.qvel, states.ctrl)))
    ranges = np.tile(ranges, (4, 1, 1))
    engines = {name: Engine(scene("scratch"), contraction=name) for name in ("off", "on", "fast")}
    times: dict[str, list[float]] = {name: [] for name in engines}
    for _ in range(REPEATS):
        for name, run in engines.items():
            start = time.perf_counter()
            run(states, 400, ranges)
            times[name].append(time.perf_counter() - start)
    for name, seconds in times.items():
        share = np.median(np.array(times["off"]) / np.array(seconds))
        print(f"contraction {name}: {1 / share:.2f} of the time without")


if __name__ == "__main__":
    main()
