"""Signs of a person that is not touched as it likes: a posture, and words.

Both say the same: by how much there is too much or too little of each wish. A person leans by
tanh(ln(done / liked) / 0.5), and says the word of the wish that is farthest off, but no wish twice
in a row while another one is off too. Shapes: N
simulations, W wishes of the task.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.persons.common import nods, uniform
from assistax_envs.preferences import ASKS, PREFERRED, WORDS, code, middles
from assistax_envs.tasks.gentle_base import STEP

LINGERS = 1.0  # s, for which a touch is felt after it
LONG = 10.0  # s
LEANS = 0.3  # s, in which it leans
HALFWAY = 0.5  # of the logarithm of done over liked, where leaning bends
ANNOYS = 0.25  # of that logarithm, from where on a person asks for something else
PLEASED = 1.0  # s that a touch has to be as liked before it is called good, beside the delay
QUIET = 0.2  # share of its expression that a person has which never speaks
# Wishes of which there is too much when the tool is far away: a person leans towards it then.
FAR = ("distance", "wait")
SPOKEN = np.uint32(0x51ED270B)  # changes the seed of chance that words take
STOP, GOOD = code("stop"), code("good")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Signs:
    """State of a person's signs."""

    off: jax.Array  # [N, W] logarithm of done over liked
    gap: jax.Array  # [N, W] s since each wish was last judged
    leans: jax.Array  # [N, W] -1 to 1: how far it leans for each wish; positive is away
    cause: jax.Array  # [N] int32, the word that a person has a reason for; 0 for none
    due: jax.Array  # [N] s for which it has had that reason
    since: jax.Array  # [N] s since it last spoke or might have
    last: jax.Array  # [N, W] bool: the wish that it last spoke of
    word: jax.Array  # [N] int32, said at this step; 0 for nothing


def silent(n: int, wishes: int) -> Signs:
    """Return the signs of N persons before they feel anything."""
    zero, none = jnp.zeros(n, jnp.float32), jnp.zeros(n, jnp.int32)
    off = jnp.zeros((n, wishes), jnp.float32)
    last = jnp.zeros((n, wishes), bool)
    return Signs(off, off + LONG, off, none, zero, zero + LONG, last, none)


class Signing:
    """The signs of a task's persons."""

    def __init__(self, task: str) -> None:
        wishes = PREFERRED.get(task, ())
        self._names = wishes
        self._middles = np.array([middles(task)], np.float32)
        # Codes [W, 2] of the words for too much and too little; 0 for a wish without words.
        words = [ASKS.get(wish, ("", "")) for wish in wishes]
        self._words = np.array(
            [[code(w) if w else 0 for w in pair] for pair in words], np.int32
        ).reshape(-1, 2)
        self.wishes = len(wishes)
        self._way = np.array([-1.0 if wish in FAR else float(wish in ASKS) for wish in wishes])

    def show(
        self,
        signs: Signs,
        felt: jax.Array,
        stopped: jax.Array,
        numbers: dict[str, jax.Array],
        chance: tuple[jax.Array, jax.Array],
    ) -> tuple[Signs, jax.Array]:
        """Return the signs after a step, and how far a person leans for each wish now [N, W].

        Args:
            signs: The signs.
            felt: [N, 2W] the touch of a delay ago as `care.felt_by` has it.
            stopped: [N] bool, whether the person is hurt.
            numbers: The persons' numbers by name.
            chance: Seeds [N] uint32 and ages [N] of the persons.
        """
        seed, age = chance
        done, judged = jnp.split(felt, 2, axis=1)
        liked = jnp.stack([numbers[f"liked_{name}"] for name in self._names], axis=-1)
        ratio = done * self._middles / liked
        signs = self.felt(signs, ratio, judged > 0.5, numbers)
        signs = self.speak(signs, stopped, numbers, uniform(seed ^ SPOKEN, age, 3))
        return signs, signs.leans * nods(age, numbers)[:, None]

    def felt(
        self, signs: Signs, ratio: jax.Array, judged: jax.Array, numbers: dict[str, jax.Array]
    ) -> Signs:
        """Return the signs after feeling `ratio` [N, W], done over liked, where it is `judged`."""
        off = jnp.where(judged, jnp.log(jnp.clip(ratio, 1e-2, 1e2)), signs.off)
        gap = jnp.where(judged, 0.0, jnp.minimum(signs.gap + STEP, LONG))
        share = numbers["expressive"] * jnp.where(numbers["talkative"] > 0.0, 1.0, QUIET)
        way = jnp.asarray(self._way, jnp.float32)[None]
        aim = (gap < LINGERS) * way * jnp.tanh(off / HALFWAY) * share[:, None]
        # It leans slowly: a tool that touches now and then would shake it.
        leans = signs.leans + STEP / LEANS * (aim - signs.leans)
        return dataclasses.replace(signs, off=off, gap=gap, leans=leans)

    def speak(
        self, signs: Signs, stopped: jax.Array, numbers: dict[str, jax.Array], chance: jax.Array
    ) -> Signs:
        """Return the signs after speaking or not.

        "stop" goes first, then the wish that is farthest off, and "good" if all are near.

        Args:
            signs: The signs.
            stopped: [N] bool, whether the person is hurt.
            numbers: The persons' numbers by name.
            chance: [N, 3] uniform numbers of this step.
        """
        wanted = self._wanted(signs, stopped)
        # A reason that is away for a moment is not forgotten.
        same = (wanted == signs.cause) & (wanted > 0)
        due = jnp.where(same, signs.due + STEP, jnp.maximum(signs.due - STEP, 0.0))
        # Who is hurt forgets all other reasons.
        other = (due <= 0.0) | ((wanted == STOP) & ~same)
        cause = jnp.where(other, wanted, signs.cause)
        since = signs.since + STEP
        wait = numbers["word_delay"] + jnp.where(cause == GOOD, PLEASED, 0.0)
        # Nor is it remembered for longer than it takes to say it.
        due = jnp.where(other, 0.0, jnp.minimum(due, wait + 2.0 * STEP))
        ready = (cause > 0) & same & (due > wait) & (since > numbers["word_pause"])
        any_word = 1 + jnp.floor(chance[:, 2] * len(WORDS)).astype(jnp.int32)
        word = jnp.where(chance[:, 1] < numbers["word_error"], any_word, cause)
        speaks = ready & (chance[:, 0] < numbers["talkative"])
        asks = (jnp.asarray(self._words)[None] == cause[:, None, None]).any(axis=-1)
        return dataclasses.replace(
            signs,
            last=jnp.where((ready & (cause < STOP))[:, None], asks, signs.last),
            cause=cause,
            due=due,
            since=jnp.where(ready, 0.0, since),
            word=jnp.where(speaks, word, 0).astype(jnp.int32),
        )

    def _wanted(self, signs: Signs, stopped: jax.Array) -> jax.Array:
        """Return the word [N] that a person has a reason for now; 0 for none."""
        if not self.wishes:
            return jnp.where(stopped, STOP, 0)
        words = jnp.asarray(self._words)
        counts = (signs.gap < LINGERS) & (words[:, 0] > 0)[None]
        far = jnp.where(counts, jnp.abs(signs.off), 0.0)
        others = jnp.where(signs.last, 0.0, far)
        far = jnp.where((others > ANNOYS).any(axis=1, keepdims=True), others, far)
        row, worst = jnp.arange(far.shape[0]), far.argmax(axis=1)
        asked = jnp.where(signs.off[row, worst] > 0.0, words[worst, 0], words[worst, 1])
        good = jnp.where(counts.any(axis=1), GOOD, 0)
        wanted = jnp.where(far[row, worst] > ANNOYS, asked, good)
        return jnp.where(stopped, STOP, wanted).astype(jnp.int32)
