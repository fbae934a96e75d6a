"""Words that a human may say, a closed set. Imports no JAX or MuJoCo."""

# Code 0 is silence; code k is WORDS[k - 1].
WORDS = ("softer", "harder", "slower", "faster", "closer", "farther", "stop", "good")
HEARD = 20  # steps for which the robot observes a word: 0.4 s
# By the name of a wish: the word of a person for whom there is too much of it, and too little.
ASKS: dict[str, tuple[str, str]] = {
    "force": ("softer", "harder"),
    "press": ("softer", "harder"),
    "speed": ("slower", "faster"),
    "distance": ("closer", "farther"),
    "wait": ("closer", "farther"),
    "depth": ("farther", "closer"),
}


def code(word: str) -> int:
    """Return the code of a word.

    Raises:
        ValueError: It is not one of `WORDS`.
    """
    if word not in WORDS:
        raise ValueError(f"word is {word!r}; allowed are {', '.join(WORDS)}")
    return WORDS.index(word) + 1
