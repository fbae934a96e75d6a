"""Robots' answers to words: what is done of a wish in the seconds after a person asked for less.

The same robots also play with the same persons masked. What a robot does there after moments at
which as much was done of the wish is what it does unasked.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env
from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.persons import PersonPlayer, person_params
from assistax_envs.preferences import ASKS, PREFERRED, code
from assistax_workshop.gates.persons.play import Plan, rows_of, strangers
from assistax_workshop.gates.persons.swapped import players

SIDES = ("corners", "unseen")
AFTER = (0.0, 0.5, 1.0, 2.0, 3.0)  # s after the word
FEWEST = 20  # words of a robot, below which nothing is said of it
NEAR = 50  # moments of a masked person about the nearest one, among which one is drawn

# Of steps T, robots M and persons P: "ratio" [T, M, P, W], logarithm of done over liked, NaN where
# the wish is not judged; "word" [T, M, P], the code of the word said; "return" [M, P].
Trace = Mapping[str, np.ndarray]


def play_words(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return what robots do after each word, by kind of robot, with and without signs."""
    met = np.concatenate([strangers(side) for side in SIDES])
    found = {}
    for name, env, policy, params in players(plan):
        trace = _tracer(plan, env, policy, params)
        signs, masked = (trace(rows_of(plan.task, met, hidden)) for hidden in (False, True))
        returns = {"signs": signs["return"], "masked": masked["return"]}
        found[name] = {
            "return": {seen: values.mean(axis=1).tolist() for seen, values in returns.items()},
            "words": answers(plan.task, signs, masked),
        }
        with_signs, without = (values.mean() for values in returns.values())
        progress(f"words, {name}: return {with_signs:.1f}, without signs {without:.1f}")
    return {"about": {"task": plan.task, "sides": SIDES, "after": AFTER}, "robots": found}


def answers(task: str, signs: Trace, masked: Trace) -> dict[str, Any]:
    """Return the medians of log(done / liked) after each word, by wish and word.

    Each has "words" [M], how many were said while the wish was judged; "asked" [M, 5], at the times
    `AFTER`; and "unasked" [M, 5], of masked persons from moments with the same ratio. A robot that
    heard fewer than `FEWEST` words has None, and a time at which too few are judged as well.
    """
    found: dict[str, Any] = {}
    for place, wish in enumerate(PREFERRED[task]):
        for word in ASKS.get(wish, ()):  # of a place no word says anything
            said = signs["word"] == code(word)
            said[1:] &= signs["word"][:-1] != code(word)
            by_robot = [
                _answer(signs["ratio"][:, m, :, place], masked["ratio"][:, m, :, place], said[:, m])
                for m in range(said.shape[1])
            ]
            count, asked, unasked = zip(*by_robot, strict=True)
            found[f"{wish}, {word}"] = {"words": count, "asked": asked, "unasked": unasked}
    return found


def _answer(
    signs: np.ndarray, masked: np.ndarray, said: np.ndarray
) -> tuple[int, list[float | None] | None, list[float | None] | None]:
    """Return the number of words, and the medians after them and without them; all [T, P]."""
    last = len(signs) - round(AFTER[-1] * 50) - 1
    moments = np.nonzero(said[:last] & np.isfinite(signs[:last]))
    others = np.nonzero(np.isfinite(masked[:last]))
    if len(moments[0]) < FEWEST or len(others[0]) < NEAR:
        return len(moments[0]), None, None
    order = np.argsort(masked[others], kind="stable")
    near = np.searchsorted(masked[others][order], signs[moments])
    near += np.random.default_rng(0).integers(-NEAR // 2, NEAR // 2 + 1, len(near))
    chosen = order[near.clip(0, len(order) - 1)]
    alike = others[0][chosen], others[1][chosen]
    return len(moments[0]), _medians(signs, moments), _medians(masked, alike)


def _medians(ratio: np.ndarray, moments: tuple[np.ndarray, ...]) -> list[float | None]:
    """Return the medians of ratios [T, P] at the times `AFTER` from moments, as steps, persons.

    One is None if the wish is judged after fewer than `FEWEST` of the moments.
    """
    steps, persons = moments
    after = [ratio[steps + round(seconds * 50), persons] for seconds in AFTER]
    judged = [values[np.isfinite(values)] for values in after]
    return [float(np.median(v)) if len(v) >= FEWEST else None for v in judged]


def _tracer(plan: Plan, env: Env, policy: Any, params: Any) -> Callable[[np.ndarray], Trace]:
    """Return a function that plays an episode of robots [M] with persons of rows [P, 31]."""
    robots, person = len(jax.tree.leaves(params)[0]), PersonPlayer(plan.task)
    act, length = jax.vmap(policy.act), plan.horizon or env.episode_length

    @jax.jit
    def play(state: Any, rows: jax.Array) -> dict[str, jax.Array]:
        sizes = robots, len(rows) // robots

        def step(loop: Any, _: None) -> tuple[Any, dict[str, jax.Array]]:
            state, mind, carry, alive = loop
            first = state.step == 0
            mind, human = person.act({"row": rows}, mind, state.obs["human"], first)
            obs = state.obs["robot"].reshape(*sizes, -1)
            carry, robot = act(params, carry, obs, first.reshape(sizes))
            word = person.word(mind)
            actions = {"robot": robot.reshape(len(rows), -1), "human": human, "word": word}
            state = env.step(state, actions)
            measured: Any = state.measures
            ratio = jnp.log(jnp.maximum(measured.done, 1e-3) / measured.liked)
            seen = {
                "ratio": jnp.where(measured.judged & alive[:, None], ratio, jnp.nan),
                "word": jnp.where(alive, word, 0),
                "reward": jnp.where(alive, state.reward, 0.0),
            }
            seen = {name: v.reshape(*sizes, *v.shape[1:]) for name, v in seen.items()}
            return (state, mind, carry, alive & ~state.terminated), seen

        mind, carry = person.initial_carry((len(rows),)), policy.initial_carry(sizes)
        begin = state, mind, carry, jnp.ones(len(rows), bool)
        return jax.lax.scan(step, begin, length=length)[1]

    @own_settings()
    def trace(rows: np.ndarray) -> Trace:
        every = np.tile(rows, (robots, 1))
        keys = jax.random.split(key_of(99), len(every))
        seen = play(env.reset(keys, person_params(plan.task, every)), jnp.asarray(every))
        found = {name: np.asarray(values) for name, values in seen.items()}
        return {**found, "return": found["reward"].sum(axis=0)}

    return trace
