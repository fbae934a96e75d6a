"""The groups of a panel's partners, which count the same in M_test, whatever their sizes."""

from collections.abc import Sequence

from assistax_envs.persons.rows import FAMILIES, OWN_PREFIX, family_group

TEAMS = "teams"  # trained policies, where persons play too


def groups_of(algorithms: Sequence[str]) -> tuple[str, ...] | None:
    """Return the group of each partner; None unless persons play.

    Args:
        algorithms: Of each partner [P]: a person's family, or how a team was trained.
    """
    if not set(algorithms) & set(FAMILIES):
        return None
    return tuple(
        family_group(name) if name in FAMILIES or name.startswith(OWN_PREFIX) else TEAMS
        for name in algorithms
    )
