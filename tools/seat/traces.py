"""Functions of a module: what is traced of a task, its scripts, its persons and its robots."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.env import Env, make
from assistax_envs.humans import disability_params
from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.persons.rows import person_kind
from assistax_envs.preferences import PREFERENCES
from assistax_envs.registered import TASK_CLASSES
from assistax_envs.tasks.chain import SCRIPTS, script_of, told_script_of
from evaluation.seat.visitor import Visitor
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.play.tally import Tally, accumulate, begin
from tools.seat.emitter import Layout, function
from tools.seat.rules import RULES

FIXED = ("tremor", "params", "key")  # fields of a state that no visitor changes


@dataclasses.dataclass(frozen=True)
class Traced:
    """A function of named trees, which returns a tuple of named trees."""

    name: str
    run: Callable[..., tuple[Any, ...]]
    reads: tuple[str, ...]
    writes: tuple[str, ...]


class TaskTraces:
    """Functions and memory of a task's module; each array has axis N of length 1."""

    @own_settings()
    def __init__(self, task: str, spec: PolicySpec) -> None:
        """Prepare.

        Args:
            task: Name of a gentle task.
            spec: Shape of the robots' network.
        """
        self.env: Env = make(task, backend="fused")
        self.spec, self.policy = spec, Policy(spec)
        self.visitor = Visitor(task, self.env.model)
        self.humans = disability_params(["d1"], ["p5"])
        self._key = jax.random.split(key_of(0), 1)
        state = jax.eval_shape(self.env.reset, self._key, self.humans)
        self._task: Any = TASK_CLASSES[task](self.env.model)
        self._by_wish = self._leaves_by_wish()
        self.layout = Layout()
        layout = self.layout.add
        layout("state", kept(state))
        layout("robot", jnp.zeros((1, self.env.action_size["robot"])))
        layout("human", jnp.zeros((1, self.env.action_size["human"])))
        layout("word", jnp.zeros(1, jnp.int32))
        layout("pointer", jnp.zeros((1, self.visitor.pointer_size)))
        layout("body", jax.eval_shape(self.visitor.initial, state.obs["human"]))
        layout("carry", self.policy.initial_carry((1,)))
        layout("first", jnp.zeros(1, bool))
        layout("params", jax.eval_shape(self.policy.init, jax.random.key(0)))

    def functions(self) -> list[Traced]:
        """Return the functions of the module."""
        traced = [
            Traced("begin", self._begin, ("state",), ("state", "body", "tally")),
            Traced(
                "step",
                self._step,
                ("state", "robot", "human", "word", "tally"),
                ("state", "tally"),
            ),
            Traced("visitor", self._visitor, ("body", "state", "pointer"), ("body", "human")),
            Traced("view", self._view, ("state", "body"), ("view",)),
            Traced("script", self._script, ("state",), ("robot",)),
            Traced(
                "network",
                self._network,
                ("params", "carry", "state", "first"),
                ("carry", "robot"),
            ),
        ]
        if SCRIPTS[self.env.task].told is not None:
            traced.append(Traced("told", self._told, ("state",), ("robot",)))
        return traced

    @own_settings()
    def text(self) -> str:
        """Return the C++ of all functions."""
        return "\n".join(
            function(one.name, self.layout, RULES, one.run, one.reads, one.writes)
            for one in self.functions()
        )

    def full(self, state: Any) -> Any:
        """Return a state with the fields that a module leaves out."""
        size = self.env.action_size["human"]
        tremor = jnp.zeros((1, size, 2), jnp.float32)
        return dataclasses.replace(state, params=self.humans, key=self._key, tremor=tremor)

    def _begin(self, state: Any) -> tuple[Any, ...]:
        task = self._wished(state.task)
        made = self.env.begin(state.physics.qpos, task, self._key, self.humans)
        return kept(made), self.visitor.initial(made.obs["human"]), begun_tally(made)

    def _wished(self, task: Any) -> Any:
        """Return a start with what follows from its human's wishes, such as a place on the body."""
        humans = dataclasses.replace(self.humans, preference=task.preference)
        _, drawn = jax.vmap(self._task.reset)(self._key, humans)
        leaves, structure = jax.tree_util.tree_flatten_with_path(drawn)
        chosen = [
            wished if jax.tree_util.keystr(path) in self._by_wish else given
            for (path, wished), given in zip(leaves, jax.tree.leaves(task), strict=True)
        ]
        return jax.tree_util.tree_unflatten(structure, chosen)

    def _leaves_by_wish(self) -> set[str]:
        """Return the leaves of a drawn start that differ where the human has other wishes."""
        starts = [
            jax.vmap(self._task.reset)(self._key, disability_params(["d1"], [wish]))[1]
            for wish in PREFERENCES
        ]
        rows = [jax.tree_util.tree_flatten_with_path(start)[0] for start in starts]
        return {
            jax.tree_util.keystr(leaf[0][0])
            for leaf in zip(*rows, strict=True)
            if any(not np.array_equal(leaf[0][1], other, equal_nan=True) for _, other in leaf[1:])
        }

    def _step(self, state: Any, robot: Any, human: Any, word: Any, tally: Tally) -> tuple[Any, ...]:
        action, before = {"robot": robot, "human": human, "word": word}, self.full(state)
        made = self.env.step(before, action)
        return kept(made), accumulate(tally, before, made, {}, None, state.step[0])

    def _visitor(self, body: Any, state: Any, pointer: Any) -> tuple[Any, ...]:
        return self.visitor.act(body, state.obs["human"], pointer)

    def _view(self, state: Any, body: Any) -> tuple[Any, ...]:
        now, intended = self.visitor.place(body, state.obs["human"])
        view = {"now": now, "intended": intended}
        if self.visitor.at_mouth:
            seen = person_kind(self.env.task).columns["forward"]
            view["forward"] = state.obs["human"][:, seen]
        return (view | self.env.marks(self.full(state)),)

    def _script(self, state: Any) -> tuple[Any, ...]:
        return (script_of(self.env.task, self.env.model)(state.obs["robot"]),)

    def _told(self, state: Any) -> tuple[Any, ...]:
        wishes = state.measures.liked
        return (told_script_of(self.env.task, self.env.model)(state.obs["robot"], wishes),)

    def _network(self, params: Any, carry: Any, state: Any, first: Any) -> tuple[Any, ...]:
        return self.policy.act(params, carry, state.obs["robot"], first)


def begun_tally(state: Any) -> Tally:
    """Return the sums of an episode at its start, without those of joints and of windows."""
    return dataclasses.replace(begin(state, {}), touch={})


def kept(state: Any) -> Any:
    """Return a state without the fields that no visitor changes."""
    return dataclasses.replace(state, **dict.fromkeys(FIXED))
