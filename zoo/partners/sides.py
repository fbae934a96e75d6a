"""Names of a split and of a side of it, as a user gives them."""

from collections.abc import Collection

SIDES = {
    "test": ("test",),
    "train": ("train",),
    "validation": ("validation",),
    "both": ("train", "test"),
}
DEFAULT_SIDE = "test"


def parse_split(text: str | None, namespaces: Collection[str]) -> tuple[str | None, str]:
    """Return a split's id, None for the default one, and the side that a text asks for.

    The text is a side ("both"), an id ("half-s0"), or both ("half-s0:both"); before each may stand
    the namespace of a zoo that was added ("lab:half-s0:both"), "lab:" alone for its default split.

    Raises:
        ValueError: The text after the last colon is no side.
    """
    text = text or DEFAULT_SIDE
    namespace, _, rest = text.partition(":")
    prefix = f"{namespace}:" if namespace and namespace in namespaces else ""
    rest = rest if prefix else text
    name, _, side = ("", "", rest) if rest in SIDES else rest.partition(":")
    if (side or DEFAULT_SIDE) not in SIDES:
        raise ValueError(f"split is {text!r}; after the colon {', '.join(SIDES)} are allowed")
    return prefix + name or None, side or DEFAULT_SIDE
