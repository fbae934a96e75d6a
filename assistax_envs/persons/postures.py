"""The posture of the arm that helps the robot.

A person looks for it among postures in which its arm lies in nothing and that it can hold. It
shows the skin that is to be touched to where the tool can come from, or brings the forearm to its
place. Shapes: N simulations, M postures, K points.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.persons.body import Arm
from assistax_envs.persons.rows import person_kind
from assistax_envs.persons.senses import Senses
from assistax_envs.registered import load
from assistax_envs.tasks.base import LOWER_ARM
from assistax_envs.tasks.person import ArmHelp

EFFORT = 0.1  # of showing a point fully, for each square radian away from rest
REACH = 0.65  # m from the robot's shoulder, beyond which it has to stretch for what it is shown
RAISED = 0.15  # m above rest that a forearm is held up without tiring
AT_EASE = 0.8  # share of the strength that holding a posture may take
SEEN = 0.25  # cosine of the angle from which on a point counts as shown
THERE = 0.1  # m
NEARER = 4  # steps of damped least squares from the table's posture to one that is nearer
DAMPING = 1e-3  # m^2
SOFTLY = 0.1  # width of that step


class Postures:
    """Chooses among the postures of a task's scene."""

    def __init__(self, task: str, arm: Arm) -> None:
        help = person_kind(task).help
        assert isinstance(help, ArmHelp)
        self.help, self._arm = help, arm
        table = arm.postures(self.help.most)
        self._angles, self._load = table["angles"], table["load"]
        self._position, self._turn = table["position"], table["turn"]
        effort = ((self._angles - arm.rest) ** 2).sum(axis=1)
        raised = self._position[:, LOWER_ARM, 2] - self._position[0, LOWER_ARM, 2] - RAISED
        self._ease = -EFFORT * effort - 4.0 * np.maximum(raised, 0.0)  # [M]
        if self.help.hidden:
            self._from = np.stack([self._side(segment) for segment in range(2)])
        if self.help.chooses == "shows":
            self._shown = self._show(*load(self.help.points)(arm.model))
        self._choose: Callable[..., jax.Array] = getattr(self, f"_{self.help.chooses}")

    def best(self, senses: Senses, strength: jax.Array, place: jax.Array) -> jax.Array:
        """Return the posture [N, 3] that helps.

        Args:
            senses: what a person perceives.
            strength: [N] share of the seat's torque that it has.
            place: [N] m, preferred place of the forearm across the waist; other tasks ignore it.
        """
        score = self._choose(senses, place) + jnp.asarray(self._ease)[None]
        if np.isfinite(self.help.most):
            load = jnp.asarray(self._load)[None] / strength[:, None]
            score = score - 4.0 * jnp.maximum(0.0, load - AT_EASE)
        chosen = jnp.asarray(self._angles)[score.argmax(axis=1)]
        return self._nearer(chosen, senses, place) if self.help.chooses == "brings" else chosen

    def there(self, senses: Senses, place: jax.Array) -> jax.Array:
        """Return whether the forearm lies at its preferred place, [N]; arguments as of `best`."""
        return jnp.linalg.norm(self._way(senses, place), axis=-1) < THERE

    def _presents(self, senses: Senses, place: jax.Array) -> jax.Array:
        """Return a score [N, M] of how well each posture shows the target."""
        del place
        position, turn = self._arm.frames(senses.position)
        local = jnp.einsum("nsij,nsi->nsj", turn, senses.target[:, None] - position)
        radial = local.at[..., 2].set(0.0)
        off = jnp.abs(jnp.linalg.norm(radial, axis=-1) - jnp.asarray(self._arm.radius)[None])
        beyond = jnp.abs(local[..., 2]) - jnp.asarray(self._arm.half_length)[None]
        segment = (off + jnp.maximum(0.0, beyond)).argmin(axis=1)  # whose skin it lies on
        row = jnp.arange(segment.shape[0])
        outward = radial[row, segment]
        outward = outward / jnp.maximum(jnp.linalg.norm(outward, axis=-1, keepdims=True), 1e-6)
        turns = jnp.asarray(self._turn)[:, segment]  # [M, N, 3, 3]
        normal = jnp.einsum("mnij,nj->nmi", turns, outward)
        facing = (normal * jnp.asarray(self._from)[segment][:, None]).sum(-1)
        point = jnp.einsum("mnij,nj->nmi", turns, local[row, segment])
        point = point + jnp.swapaxes(jnp.asarray(self._position)[:, segment], 0, 1)
        far = jnp.linalg.norm(point - jnp.asarray(self._arm.robot)[None, None], axis=-1)
        return 2.0 * jnp.minimum(facing, 0.8) - 4.0 * jnp.maximum(0.0, far - REACH)

    def _shows(self, senses: Senses, place: jax.Array) -> jax.Array:
        """Return a score [N, M] of postures by the share of the left points that they show."""
        del place
        left = senses.unwiped / jnp.maximum(senses.unwiped.sum(axis=1, keepdims=True), 1.0)
        return 4.0 * left @ jnp.asarray(self._shown).T

    def _brings(self, senses: Senses, place: jax.Array) -> jax.Array:
        """Return a score [N, M] of postures by the forearm's way to its place; -1 for 10 cm."""
        forearm = jnp.asarray(self._position)[None, :, LOWER_ARM]
        away = jnp.linalg.norm(self._goal(senses, place)[:, None] - forearm, axis=-1)
        return -10.0 * away

    def _goal(self, senses: Senses, place: jax.Array) -> jax.Array:
        """Return the preferred position of the forearm [N, 3], m."""
        position, _ = self._arm.frames(senses.position)
        return position[:, LOWER_ARM] + self._way(senses, place)

    def _nearer(self, angles: jax.Array, senses: Senses, place: jax.Array) -> jax.Array:
        """Return postures [N, 3] whose forearm lies nearer to its place than in `angles`.

        The table's postures are up to 8 cm from a place, and a forearm rests within 6 cm of it.
        """
        goal = self._goal(senses, place)
        low, high = jnp.asarray(self._arm.range.T)[:, None]
        on_lower = jnp.ones(angles.shape[0], bool)
        for _ in range(NEARER):
            position, _ = self._arm.frames(angles)
            forearm = position[:, LOWER_ARM]
            jacobian = self._arm.jacobian(angles, forearm, on_lower)
            square = jacobian @ jnp.swapaxes(jacobian, 1, 2) + DAMPING * jnp.eye(3)[None]
            step = jnp.linalg.solve(square, (goal - forearm)[..., None])
            turn = (jnp.swapaxes(jacobian, 1, 2) @ step)[..., 0]
            angles = jnp.clip(angles + jnp.clip(turn, -0.2, 0.2), low, high)
        return angles

    def _way(self, senses: Senses, place: jax.Array) -> jax.Array:
        """Return the way [N, 3] of the forearm to its preferred place, m."""
        if self.help.across is None:
            return senses.to_place
        across, observed = self.help.across
        return (
            senses.to_place + (place[:, None] - observed) * jnp.asarray(across, jnp.float32)[None]
        )

    def _side(self, segment: int) -> np.ndarray:
        """Return the direction [3] from which the tool can come to a segment at rest."""
        low, high = self.help.hidden[segment]
        angle = np.radians(0.5 * (low + high) + 180.0)
        return self._turn[0, segment] @ np.array([np.cos(angle), np.sin(angle), 0.0], np.float32)

    def _show(self, segment: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return the degree [M, K], 0 to 1, to which each posture shows each point."""
        outward = offset * np.array([1.0, 1.0, 0.0], np.float32)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        normal = np.einsum("mkij,kj->mki", self._turn[:, segment], outward)
        facing = (normal * self._from[segment]).sum(axis=-1)
        point = np.einsum("mkij,kj->mki", self._turn[:, segment], offset)
        far = np.linalg.norm(point + self._position[:, segment] - self._arm.robot, axis=-1)
        seen = 1.0 / (1.0 + np.exp((SEEN - facing) / SOFTLY))
        return (seen * np.exp(-np.maximum(0.0, far - REACH) / 0.1)).astype(np.float32)
