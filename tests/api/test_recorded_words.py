"""Words of recorded episodes: a person speaks in them, and replayed they are heard as they were."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from assistax_envs import make
from assistax_envs.env import EnvState
from assistax_envs.persons import person, person_params
from assistax_envs.persons.rows import index, marked
from assistax_envs.preferences import HEARD, WORDS
from assistax_zoo import recording
from assistax_zoo.datasets import write_dataset
from evaluation.cast.partners import Partner
from evaluation.film import Pair, play
from evaluation.player.episode import episode_content, read_episode
from tests.api.test_datasets import ABOUT
from zoo.partners.person_seat import PersonSpec
from zoo.registry import load_registry

TASK, STEPS = "gentle_scratch", 30


def spoken() -> Callable[[], Any]:
    """Return a human's words: the k-th word at step 7 k, and silence between."""
    step = iter(range(10**6))

    def word() -> Any:
        at = next(step)
        return np.int32(at // 7 + 1 if at % 7 == 0 else 0)

    return word


@dataclasses.dataclass
class Speaking:
    """A pair of idle policies, of which the human speaks, as `recording` records a pair."""

    env: Any
    references = {"robot": "zero", "human": "zero"}  # noqa: RUF012

    def play(self, check: Any, on_step: Any, episode: int, heard: Any) -> Any:
        rng = np.random.default_rng(episode)
        sizes = self.env.action_size
        acts = {
            role: heard(role, lambda obs, size=size: rng.uniform(-0.5, 0.5, size))
            for role, size in sizes.items()
        }
        return play(self.env, **acts, steps=STEPS, seed=4, word=spoken())


@pytest.fixture(scope="module")
def table() -> pl.DataFrame:
    pair: Any = Speaking(make(TASK, "native"))
    return recording._record_all(pair, 1, lambda: None, None)  # its command names policies


def test_words_stand_beside_the_actions(table: pl.DataFrame) -> None:
    assert table["word"].dtype == pl.Int32 and table["word"][-1] is None
    words = table["word"][:STEPS].to_list()
    assert words == [step // 7 + 1 if step % 7 == 0 else 0 for step in range(STEPS)]
    said = table["robot_observation"].to_numpy()[:, -len(WORDS) :]
    for step in range(1, STEPS + 1):
        assert said[step].argmax() == (step - 1) // 7 and said[step].sum() == 1.0
    assert said[0].sum() == 0.0


def test_recorded_actions_and_words_give_the_observations_to_the_bit(table: pl.DataFrame) -> None:
    env = make(TASK, "native")
    # The start is the recorded one; a step is compiled as in the recording.
    first = next(iter(Speaking(env).play(None, None, 0, lambda role, act: act)))
    seen = _replayed(env, first, table, table["word"])
    recorded = table["robot_observation"].to_numpy()
    np.testing.assert_array_equal(seen, recorded)
    silent = _replayed(env, first, table, pl.Series(np.zeros(len(table), np.int32)))
    np.testing.assert_array_equal(silent[:, : -len(WORDS)], recorded[:, : -len(WORDS)])
    assert not silent[:, -len(WORDS) :].any()  # planted: a replay that forgets the words


def _replayed(env: Any, state: EnvState, table: pl.DataFrame, words: pl.Series) -> np.ndarray:
    step, seen = jax.jit(env.step), [np.asarray(state.obs["robot"][0])]
    rows = table.with_columns(word=words).drop_nulls("reward")
    for row in rows.iter_rows(named=True):
        actions: dict[str, Any] = {
            role: jnp.float32([row[f"{role}_action"]]) for role in ("robot", "human")
        }
        state = step(state, {**actions, "word": jnp.array([row["word"]], jnp.int32)})
        seen.append(np.asarray(state.obs["robot"][0]))
    return np.stack(seen)


def test_formats_of_other_libraries_hold_the_words(table: pl.DataFrame, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    write_dataset(table, tmp_path / "pair", ABOUT, "lerobot")
    frames = pl.read_parquet(tmp_path / "pair/data/chunk-000/file-000.parquet")
    assert frames["human_word"].to_list() == table["word"][:STEPS].to_list()
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("MINARI_DATASETS_PATH", str(tmp_path))
        write_dataset(table, tmp_path / "words-v0", ABOUT, "minari")
        [episode] = minari.load_dataset("words-v0")
    assert episode.infos["word"].tolist() == [0, *table["word"][:STEPS]]


def test_player_shows_the_word_that_is_heard(
    table: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = {"task": TASK, "version": 4, "robot": "zero", "person": "zero"}
    about |= {"seed": 4, "setting": "d1"}
    # The file has no metadata, which the command writes.
    monkeypatch.setattr("evaluation.player.episode._about", lambda path: about)
    few = table.with_columns(
        word=pl.when(pl.col("step").is_in([2])).then(3).otherwise(pl.col("word") * 0)
    )
    few.write_parquet(tmp_path / "few.trajectory")
    content = episode_content(read_episode(tmp_path / "few.trajectory"))
    heard = ["slower" if 3 <= step < 3 + HEARD else "" for step in range(STEPS + 1)]
    assert content["words"] == heard
    assert ("says", "slower 1×") in content["facts"]
    bad = few.with_columns(word=pl.col("word") + 90)
    bad.write_parquet(tmp_path / "bad.trajectory")
    with pytest.raises(ValueError, match="its column word has codes that no word has"):
        read_episode(tmp_path / "bad.trajectory")


def test_a_person_speaks_with_its_player_and_alone_in_its_seat() -> None:
    """Partner.word gives what `PersonPlayer.word` gives; a talkative person does speak."""
    env = make(TASK, "native")
    row = person(TASK, 42).row.copy()
    place = index(TASK)
    row[place["talkative"]], row[place["word_delay"]], row[place["word_pause"]] = 1.0, 0.4, 0.8
    partner = Partner("someone", PersonSpec(TASK), {"row": marked(row[None])[0]})
    rng = np.random.default_rng(3)
    acts = (lambda obs: rng.uniform(-1.0, 1.0, 7), partner.act)
    humans = person_params(TASK, row[None])
    states = list(play(env, *acts, steps=400, seed=1, humans=humans, word=partner.word))
    said = [int(recording._said(state)[0]) for state in states[1:]]  # as it is recorded
    heard = np.stack([np.asarray(state.obs["robot"][0, -len(WORDS) :]) for state in states])
    assert heard.any() == (sum(said) > 0)
    assert partner.word().shape == ()


def test_networks_say_nothing() -> None:
    pair = Pair(make(TASK, "native"), "zero", "random", load_registry, steps=3)
    states = list(pair.play(lambda: None))
    assert [int(recording._said(state)[0]) for state in states] == [0] * 4
