"""A family of persons: those who are tired before anything begins."""

import dataclasses

import jax

from assistax_envs.persons.controller import Controller, Mind


class Weary(Controller):
    """Persons of the family of springs who begin with half of their strength."""

    def initial(self, n: int) -> Mind:
        """Return the carry of N persons, with half of their strength."""
        return dataclasses.replace(super().initial(n), tired=jax.numpy.full(n, 0.5))
