"""Words and postures by which persons show what they like, and words that the robot hears."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import EnvState
from assistax_envs.persons import signs
from assistax_envs.persons.player import PersonPlayer
from assistax_envs.persons.rows import FAMILIES, index, marked, persons
from assistax_envs.preferences import HEARD, PREFERRED, WORDS, code
from tests.envs.conftest import compiled, random_actions, start
from tests.envs.test_persons import somebody, watched

STEP = 0.02  # s
NUMBERS = {
    "expressive": 0.8, "talkative": 1.0, "word_delay": 0.6, "word_pause": 1.0, "word_error": 0.0,
}  # fmt: skip
TALKS = {name: NUMBERS[name] for name in NUMBERS if name != "word_error"}


# What a robot hears.


def heard_by(state: EnvState) -> list[str]:
    """Return the word that the robot of each simulation observes, or nothing."""
    said = np.asarray(state.obs["robot"])[:, -len(WORDS) :]
    np.testing.assert_array_equal(said, np.asarray(state.obs["global"])[:, -len(WORDS) :])
    assert set(np.unique(said).tolist()) <= {0.0, 1.0} and (said.sum(axis=1) <= 1.0).all()
    return ["" if row.sum() == 0.0 else WORDS[row.argmax()] for row in said]


def spoken_to(task: str, words: list[list[int] | None]) -> list[EnvState]:
    """Return the states after each step with words [4], or none of them."""
    state, step = start(task, "native", ["d1"] * 4), compiled(task, "native")[1]
    states = [state]
    for action, word in zip(random_actions(4, len(words)), words, strict=True):
        given = {} if word is None else {"word": jnp.array(word, jnp.int32)}
        states.append(step(states[-1], action | given))
    return states


def test_word_is_heard_for_four_tenths_of_a_second() -> None:
    said = [code("softer"), 0, code("good"), code("softer")]
    quiet = [0, 0, 0, 0]
    states = spoken_to("gentle_lift", [said, *[quiet] * 5, [0, 0, 0, code("stop")], *[quiet] * 25])
    heard = np.array([heard_by(state) for state in states])
    assert pytest.approx(0.4) == HEARD * STEP
    assert heard[0].tolist() == [""] * 4  # nobody has spoken
    assert heard[1:, 0].tolist() == ["softer"] * 20 + [""] * 12
    assert set(heard[:, 1].tolist()) == {""}
    assert heard[1:, 2].tolist() == ["good"] * 20 + [""] * 12
    # A new word is heard in place of the old one, for its own time.
    assert heard[1:, 3].tolist() == ["softer"] * 6 + ["stop"] * 20 + [""] * 6


def test_silence_is_the_same_with_and_without_words() -> None:
    """Networks give no words; the human's own observation never has any."""
    without, with_zeros, with_word = (
        spoken_to("gentle_lift", [word] * 3) for word in (None, [0] * 4, [1] * 4)
    )
    for one, other, spoken in zip(without, with_zeros, with_word, strict=True):
        for role in ("robot", "human", "global"):
            np.testing.assert_array_equal(one.obs[role], other.obs[role])
        np.testing.assert_array_equal(one.obs["human"], spoken.obs["human"])
        np.testing.assert_array_equal(one.reward, spoken.reward)
    assert heard_by(with_word[-1]) == ["softer"] * 4 and heard_by(without[-1]) == [""] * 4


def test_paper_tasks_hear_no_words() -> None:
    with_word, without = (spoken_to("scratch", [word])[-1] for word in ([1] * 4, None))
    assert with_word.word is None and with_word.heard is None
    np.testing.assert_array_equal(with_word.obs["global"], without.obs["global"])


# What a person says.


def said(
    task: str, ratios: np.ndarray, stopped: np.ndarray | None = None, count: int = 1,
    **numbers: float,
) -> np.ndarray:  # fmt: skip
    """Return the words [T, count] of persons that feel `ratios` [T, W] all the time."""
    made = signs.Signing(task)
    row = {name: jnp.full(count, number) for name, number in (NUMBERS | numbers).items()}
    shape = (count, ratios.shape[1])

    def step(now: signs.Signs, felt: tuple[jax.Array, jax.Array, jax.Array]):
        ratio, stop, chance = felt
        judged = jnp.broadcast_to(ratio[None] > 0.0, shape)
        now = made.felt(now, jnp.broadcast_to(ratio[None], shape), judged, row)
        now = made.speak(now, jnp.full(count, stop), row, chance)
        return now, now.word

    stops = np.zeros(len(ratios), bool) if stopped is None else stopped
    chance = np.random.default_rng(3).uniform(size=(len(ratios), count, 3)).astype(np.float32)
    felt = jnp.asarray(ratios, jnp.float32), jnp.asarray(stops), jnp.asarray(chance)
    return np.asarray(jax.lax.scan(step, signs.silent(*shape), felt)[1])


def always(*ratio: float, seconds: float = 6.0) -> np.ndarray:
    return np.array([ratio] * round(seconds / STEP))


def names(words: np.ndarray) -> list[str]:
    """Return the words that one person says, in order."""
    return [WORDS[word - 1] for word in words[:, 0] if word]


@pytest.mark.parametrize(
    ("task", "much", "little"),
    [
        ("gentle_scratch", ["softer", "slower"], ["harder", "faster"]),
        ("gentle_bath", ["softer", "slower"], ["harder", "faster"]),
        ("gentle_brushing", ["softer", "slower"], ["harder", "faster"]),
        ("gentle_feeding", ["closer", "farther"], ["farther", "closer"]),
        ("gentle_lift", ["closer", None], ["farther", None]),
    ],
)
def test_each_wish_has_its_words(task: str, much: list, little: list) -> None:
    for place in range(len(PREFERRED[task])):
        for words, ratio in ((much, 2.0), (little, 0.5)):
            felt = np.zeros(len(PREFERRED[task]))
            felt[place] = ratio
            spoken = set(names(said(task, always(*felt))))
            assert spoken == ({words[place]} if words[place] else set())


@pytest.mark.parametrize("delay", [0.4, 0.8])
def test_word_comes_after_the_delay(delay: float) -> None:
    words = said("gentle_scratch", always(2.0, 1.0), word_delay=delay)[:, 0]
    assert STEP * np.flatnonzero(words)[0] == pytest.approx(delay, abs=1.5 * STEP)


@pytest.mark.parametrize("pause", [0.8, 1.5])
def test_words_keep_their_pause(pause: float) -> None:
    words = said("gentle_scratch", always(2.0, 1.0, seconds=12.0), word_pause=pause)[:, 0]
    gaps = STEP * np.diff(np.flatnonzero(words))
    assert len(gaps) > 5 and gaps.min() > pause - 1e-6 and gaps.max() < pause + 2.0 * STEP


def test_the_farther_wish_goes_first_and_then_the_other() -> None:
    assert names(said("gentle_scratch", always(1.5, 3.0)))[:2] == ["slower", "softer"]
    assert names(said("gentle_scratch", always(3.0, 0.7)))[:2] == ["softer", "faster"]


def test_stop_goes_first() -> None:
    """Whatever it was about to say, and however long it had reason to."""
    hurt = np.arange(300) >= 200  # for 2 s, after 4 s of too much force
    words = said("gentle_scratch", always(2.0, 1.0), hurt)[:, 0]
    assert set(words[:200].tolist()) == {0, code("softer")}
    assert set(words[203:].tolist()) == {0, code("stop")}
    first = np.flatnonzero(words == code("stop"))[0] - 200
    assert STEP * first < NUMBERS["word_delay"] + NUMBERS["word_pause"] + 2.0 * STEP


def test_good_is_said_of_a_touch_that_stays_as_liked() -> None:
    words = said("gentle_scratch", always(1.1, 0.9))[:, 0]
    assert set(words.tolist()) == {0, code("good")}
    assert STEP * np.flatnonzero(words)[0] == pytest.approx(1.6, abs=2.0 * STEP)
    assert not said("gentle_scratch", always(0.0, 0.0)).any()  # nothing is felt


def test_robot_that_mends_its_touch_is_told_soon() -> None:
    """A reason that is gone does not hold back the next word for as long as it was there."""
    ratios = np.concatenate([always(2.0, 1.0, seconds=10.0), always(1.0, 1.0, seconds=5.0)])
    words = said("gentle_scratch", ratios)[500:, 0]
    good = np.flatnonzero(words == code("good"))
    # The memory of the old reason, 1 s of good touch, and the delay.
    assert len(good) and STEP * good[0] < 3.6


def test_words_are_wrong_at_their_rate() -> None:
    words = said("gentle_scratch", always(2.0, 1.0, seconds=1.0), count=20_000, word_error=0.1)
    first = words[words > 0]
    assert len(first) == 20_000
    # Any of eight words, one of which is right.
    assert (first != code("softer")).mean() == pytest.approx(0.1 * 7 / 8, abs=0.007)
    assert set(first.tolist()) == set(range(1, len(WORDS) + 1))


@pytest.mark.parametrize("talkative", [0.0, 0.5, 0.9])
def test_talkative_is_the_chance_to_speak(talkative: float) -> None:
    words = said("gentle_scratch", always(2.0, 1.0, seconds=1.0), count=20_000, talkative=talkative)
    assert (words > 0).any(axis=0).mean() == pytest.approx(talkative, abs=0.012)


@pytest.mark.parametrize(("talkative", "share"), [(1.0, 1.0), (0.0, signs.QUIET)])
def test_posture_bends_with_the_logarithm(talkative: float, share: float) -> None:
    """Away from too much, towards too little; who never speaks shows little."""
    made, ratio = signs.Signing("gentle_scratch"), jnp.array([[2.0, 0.5], [1.0, 4.0]])
    row = {name: jnp.full(2, number) for name, number in NUMBERS.items()}
    row["talkative"] = jnp.full(2, talkative)
    now = signs.silent(2, 2)
    for _ in range(200):
        now = made.felt(now, ratio, jnp.ones((2, 2), bool), row)
    leans = 0.8 * share * np.tanh(np.log(np.asarray(ratio)) / 0.5)
    np.testing.assert_allclose(now.leans, leans, atol=1e-3)
    assert leans[0, 0] > 0.0 > leans[0, 1]


# Persons in their seat.


def spoken(rows: np.ndarray, touches: np.ndarray, task: str = "gentle_scratch") -> np.ndarray:
    """Return the words [T, N] of persons under forces [T]."""
    minds, _ = watched(rows, touches, task)
    return np.array([mind.signs.word for mind in minds])


def test_pressed_person_asks_for_less_and_a_silent_one_does_not() -> None:
    task = "gentle_scratch"
    rows = somebody(count=3, liked_force=4.0, **TALKS)
    rows[1, index(task)["talkative"]] = 0.0
    rows[2, index(task)["liked_force"]] = 12.0
    words = spoken(rows, np.full(150, 8.0))
    assert code("softer") in words[:, 0] and code("harder") not in words[:, 0]
    assert not words[:, 1].any()
    assert code("harder") in words[:, 2] and code("softer") not in words[:, 2]


def test_paper_tasks_have_no_signs() -> None:
    """Persons of the paper's tasks act the same whatever their signs' numbers are, and are mute."""
    still, shows = (somebody("scratch", 2, **given) for given in ({}, TALKS))
    touches = np.concatenate([np.zeros(5), np.full(60, 12.0)])
    minds, actions = watched(still, touches, "scratch")
    assert not any(np.asarray(mind.signs.word).any() for mind in minds)
    shown, with_signs = watched(shows, touches, "scratch")
    # The row seeds an episode's chance, which nobody here has: no noise, no lapses.
    np.testing.assert_array_equal(actions, with_signs)
    assert not any(np.asarray(mind.shown).any() for mind in shown)


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("task", ["gentle_scratch", "gentle_feeding"])
def test_persons_are_the_same_in_larger_batches(task: str, family: str) -> None:
    """Actions and words of sixteen persons, alone and among forty-eight."""
    player = PersonPlayer(task)
    rows = marked(persons(task)[:48], FAMILIES.index(family))
    start_at = np.array(start(task, "fused", ["d1"] * 3, seed=3).obs["human"][0])
    rng, act = np.random.default_rng(8), jax.jit(player.act)
    # Held for 0.8 s each, for a reason that changes in every step is never said, and so far off
    # that touches are judged.
    held = np.repeat(rng.normal(0.0, 0.5, (3, 48, len(start_at))), 40, axis=0)
    seen = (start_at + held).astype(np.float32)

    def play(count: int) -> tuple[np.ndarray, np.ndarray]:
        mind, played = player.initial_carry((count,)), []
        for time, obs in enumerate(seen[:, :count]):
            first = jnp.full(count, time == 0)
            mind, action = act({"row": jnp.asarray(rows[:count])}, mind, jnp.asarray(obs), first)
            played.append((action, player.word(mind)))
        actions, words = zip(*played, strict=True)
        return np.array(actions), np.array(words)

    (actions, words), (others, more_words) = play(16), play(48)
    # A batch of another size is another program, which may round the last bit otherwise.
    np.testing.assert_allclose(actions, others[:, :16], atol=1e-6)
    np.testing.assert_array_equal(words, more_words[:, :16])
    assert actions.any() and words.any()
