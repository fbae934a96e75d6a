"""Words of messages."""

import pytest

from assistax_base.errors import counted


@pytest.mark.parametrize(
    ("count", "what", "text"),
    [
        (1, "seed", "1 seed"),
        (2, "seed", "2 seeds"),
        (0, "policy", "0 policies"),
        (1, "new policy", "1 new policy"),
        (3, "new policy", "3 new policies"),
    ],
)
def test_a_number_of_things_is_one_or_several(count: int, what: str, text: str) -> None:
    assert counted(count, what) == text
