"""Environment versions, readable without JAX or MuJoCo.

A version is an integer. It is raised when the same actions from the same key give other
observations, rewards or episode ends on the same MuJoCo version: a changed model, task, observation
or reward. It is not raised for speed, rendering or documentation. `tests/envs/test_golden.py`
guards it.
"""

VERSIONS: dict[str, int] = {"scratch": 1, "bed_bath": 1, "arm_assist": 2}

TASKS: tuple[str, ...] = tuple(VERSIONS)
