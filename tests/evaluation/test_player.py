"""The player of episodes shows recordings, and refuses impossible ones."""

import base64
import json
import re
import zlib
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars as pl
import pytest
from playwright.sync_api import Browser, Page, expect

import assistax_zoo as az
from assistax_base.digest import sha256
from assistax_base.files import METADATA_KEY
from assistax_envs.drawing.render import picture_model
from assistax_envs.persons.rows import index, person
from assistax_envs.preferences import PREFERRED
from assistax_envs.registered import REGISTERED
from assistax_envs.versions import VERSIONS
from evaluation.player.episode import (
    PREFERENCE_WORDS,
    Episode,
    episode_content,
    read_episode,
)
from evaluation.player.page import write_episode
from evaluation.player.viewer import LEFT, RIGHT, SPACE, Clock
from tests.board.browser import browsing, opened
from tests.system import CHROMIUM, needs

ROOT = Path(__file__).parents[2]
TASK, STEPS = "gentle_scratch", 100
PERSON = f"{TASK}/person-00042-v1"
SCRIPT = f"""
import assistax_envs
from assistax_envs.tasks.chain import script_of

def make():
    return script_of("{TASK}", assistax_envs.make("{TASK}", "native").model)
"""
HOSTILE = "x</script><script>alert(1)</script>"


def record(folder: Path, robot: str, human: str, steps: int, seed: int = 0) -> Path:
    out = folder / "pair.trajectory"
    options = {"episodes": 2, "steps": steps, "seed": seed, "backend": "native"}
    az.trajectories(robot, human, task=TASK, out=out, **options)
    return out


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The task's script, which touches the person in the first two seconds."""
    folder = tmp_path_factory.mktemp("pair")
    (folder / "follower.py").write_text(SCRIPT)
    return record(folder, f"python:{folder / 'follower.py'}:make", PERSON, STEPS, seed=0)


@pytest.fixture(scope="module")
def episode(recording: Path) -> Episode:
    return read_episode(recording)


@pytest.fixture(scope="module")
def browser() -> Generator[Browser]:
    with browsing() as browser:
        yield browser


def shown_in(browser: Browser, page_file: Path, width: int = 1280) -> Iterator[Page]:
    """Yield a page once its player is ready, and check that it loads nothing else."""
    asked: list[str] = []
    with opened(browser, width) as page:
        page.on("request", lambda request: asked.append(request.url))
        page.emulate_media(reduced_motion="reduce")  # nothing moves by itself
        page.goto(page_file.as_uri())
        page.wait_for_selector("[data-steps]", timeout=60_000)
        yield page
        assert [url for url in asked if not url.startswith("data:")] == [page_file.as_uri()]


def test_an_episode_is_that_of_the_table(recording: Path, episode: Episode) -> None:
    rows = pl.read_parquet(recording).filter(episode=0)
    steps = rows.drop_nulls("reward")
    np.testing.assert_array_equal(episode.poses, rows["pose"].to_numpy())
    for values, column in ((episode.force, "force"), (episode.reward, "reward")):
        assert values[0] == 0.0
        np.testing.assert_array_equal(values[1:], steps[column].to_numpy().astype(float))
    assert sum(values[1:] for values in episode.terms.values()) == pytest.approx(
        steps["reward"].to_numpy(), abs=1e-4
    )
    wishes = {"force": rows["wish_force"][0], "speed": rows["wish_speed"][0]}
    liked = person(TASK, 42).row[[index(TASK)[f"liked_{wish}"] for wish in wishes]]
    assert episode.preferences == wishes and list(wishes.values()) == pytest.approx(liked)
    assert not episode.stopped


def test_arrows_carry_the_recorded_force(episode: Episode) -> None:
    """The arrows' forces sum to the recorded force."""
    touches = episode_content(episode)["touches"]
    counted = 0
    for newtons, arrows in zip(episode.force, touches, strict=True):
        if arrows:
            counted += 1
            assert sum(arrow[6] for arrow in arrows) == pytest.approx(newtons, rel=1e-3)
            assert np.linalg.norm(np.array(arrows)[:, 3:6], axis=1) == pytest.approx(1.0, abs=1e-3)
        else:
            assert newtons < 1.0
    assert counted > 3 and max(episode.force) > 10.0


def test_targets_follow_arm(episode: Episode) -> None:
    """The itch is fixed to the arm, at a constant distance from its segment's middle."""
    model = picture_model(TASK)
    data = mujoco.MjData(model)
    gaps = []
    for pose, itch in zip(episode.poses, episode.targets["itch"], strict=True):
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        names = ("human_right_upper_arm", "human_right_lower_arm")
        gaps.append([np.linalg.norm(data.body(name).xpos - itch) for name in names])
    assert np.ptp(np.array(gaps), axis=0).min() < 1e-4
    assert np.ptp(episode.targets["itch"], axis=0).max() > 1e-3, "and the arm moved"


def test_protective_stop_ends_playback(recording: Path, tmp_path: Path) -> None:
    def stop(table: pl.DataFrame) -> pl.DataFrame:
        late = (pl.col("step") >= 7) & pl.col("reward").is_not_null()
        return table.with_columns(terminated=pl.when(late).then(True).otherwise("terminated"))

    shown = read_episode(changed(recording, tmp_path, stop))
    assert shown.stopped and len(shown.poses) == len(shown.reward) == 9
    assert "protective stop" in dict(episode_content(shown)["facts"])["episode"]


def changed(
    recording: Path,
    folder: Path,
    change: Callable[[pl.DataFrame], pl.DataFrame],
    about: Callable[[dict[str, Any]], object] | None = None,
) -> Path:
    """Return a copy of a recording with a changed table or changed metadata."""
    metadata = json.loads(pl.read_parquet_metadata(recording)[METADATA_KEY])
    if about is not None:
        about(metadata)
    out = folder / "changed.trajectory"
    table = change(pl.read_parquet(recording))
    table.write_parquet(out, metadata={METADATA_KEY: json.dumps(metadata)})
    return out


def poses(fill: float, width: int = 16) -> Callable[[pl.DataFrame], pl.DataFrame]:
    def change(table: pl.DataFrame) -> pl.DataFrame:
        values = np.full((table.height, width), fill, np.float32)
        return table.with_columns(pose=pl.Series(values))

    return change


DAMAGES: dict[str, tuple[Callable[[pl.DataFrame], pl.DataFrame], str]] = {
    "NaN": (poses(float("nan")), "column pose has numbers that no episode has"),
    "infinite": (poses(float("inf")), "column pose has numbers that no episode has"),
    "huge": (poses(1e9), "column pose has numbers that no episode has"),
    "narrow": (poses(0.0, 15), r"column pose is Array\(Float32, shape=\(15,\)\)"),
    "text": (lambda t: t.with_columns(pose=pl.lit("x")), "column pose is String"),
    "null": (lambda t: t.with_columns(pose=pl.lit(None)), "column pose is Null"),
    "none": (lambda t: t.drop("pose"), "an older version recorded it"),
    "no force": (lambda t: t.drop("force"), "it has no column force"),
    "no target": (lambda t: t.select(pl.exclude("^target_.*$")), "it has no targets"),
    "force text": (lambda t: t.with_columns(force=pl.lit("1")), "column force is String"),
    "infinite force": (lambda t: t.with_columns(force=pl.lit(float("inf"))), "column force has n"),
    "no rows": (lambda t: t.clear(), "episode 0 has 0 rows"),
    "endless": (lambda t: pl.concat([t] * 40), "it must have 2 to 1001"),
    "moods": (
        lambda t: t.with_columns(wish_force=pl.col("step").cast(float)),
        "preference of force changes, or is not above 0",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_recording_is_refused(damage: str, recording: Path, tmp_path: Path) -> None:
    change, reason = DAMAGES[damage]
    path = changed(recording, tmp_path, change)
    with pytest.raises(ValueError, match=rf"changed\.trajectory cannot be played \(.*{reason}"):
        read_episode(path)


@pytest.mark.parametrize(
    ("about", "reason"),
    [
        (lambda said: said.clear(), "does not say who plays what"),
        (lambda said: said.update(task="swim"), "its task is 'swim'; known are scratch"),
        (lambda said: said.update(task=["scratch"]), "its task is"),
        (lambda said: said.update(robot={"policy": "x" * 300}), "more than 200 characters"),
        (lambda said: said.update(robot="x"), "does not say who plays what"),
        (lambda said: said.update(seed="1e999"), "does not say who plays what"),
        (lambda said: said.update(disability={"strength": 7}), "does not say who plays what"),
        (lambda said: said.update(disability="d99"), "does not say who plays what"),
    ],
)
def test_malformed_recording_is_refused(
    about: Callable[[dict[str, Any]], object], reason: str, recording: Path, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=reason):
        read_episode(changed(recording, tmp_path, lambda table: table, about))


def test_cut_foreign_and_empty_files_are_refused(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.trajectory"
    for data in (recording.read_bytes()[:-500], b"no table"):
        cut.write_bytes(data)
        with pytest.raises(ValueError, match=r"cut\.trajectory is not a readable Parquet file"):
            read_episode(cut)
    with pytest.raises(ValueError, match="there is no file"):
        read_episode(tmp_path / "gone")
    with pytest.raises(ValueError, match="episode 2 has 0 rows"):
        read_episode(recording, 2)
    assert len(read_episode(recording, 1).poses) == STEPS + 1


def test_no_name_breaks_out_of_the_page(recording: Path, tmp_path: Path) -> None:
    def name(said: dict[str, Any]) -> None:
        said["robot"] = {"policy": HOSTILE}

    shown = read_episode(changed(recording, tmp_path, lambda table: table, name))
    write_episode(episode_content(shown), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "alert" not in text and text.count("<script>") == 4
    data = re.search(r'data-episode="([^"]*)"', text)
    assert data is not None
    unpacked = json.loads(zlib.decompress(base64.b64decode(data[1])))
    assert unpacked["robot"] == HOSTILE
    assert unpacked == json.loads(json.dumps(episode_content(shown)))


def test_vendored_script_matches_notice() -> None:
    script = ROOT / "evaluation" / "report" / "assets" / "three.min.js"
    notice = (ROOT / "NOTICE").read_text(encoding="utf-8")
    assert sha256(script.read_bytes()) in notice and script.stat().st_size < 800_000
    bundle = (ROOT / "tools" / "three_bundle.sh").read_text(encoding="utf-8")
    [tarball] = re.findall(r"^tarball=(\w{64})$", bundle, re.MULTILINE)
    assert tarball in notice and "three.js 0.187.0" in notice and "three=0.187.0" in bundle


def test_keys_of_the_viewer_stop_and_step() -> None:
    clock = Clock(100, 0.02)
    assert [clock.step(now) for now in (5.0, 5.2, 5.4)] == [0, 10, 20]
    clock.press(SPACE)
    assert clock.step(9.0) == 20
    clock.press(RIGHT)
    assert clock.step(9.1) == 21
    for _ in range(22):
        clock.press(LEFT)
    assert clock.step(9.2) == 99, "from the start back to the end"
    clock.press(SPACE)
    assert clock.step(9.7) == 24


# In the browser.
BODIES = "step => { const p = document.querySelector('[data-steps]').episodePlayer; "
BODIES += "p.seek(step); return p.bodies(); }"
CONTENT = "document.querySelector('[data-steps]').episodePlayer.episode"

# How many colours the drawn scene has, looked at in the frame in which it was drawn.
COLOURS = """new Promise((done) => {
  document.querySelector("[data-steps]").episodePlayer.seek(1);
  requestAnimationFrame(() => {
    const context = document.createElement("canvas").getContext("2d");
    context.drawImage(document.querySelector("canvas"), 0, 0, 300, 150);
    const { buffer } = context.getImageData(0, 0, 300, 150).data;
    done(new Set(new Uint32Array(buffer)).size);
  });
})"""

# Records each text of the button, because "Pause" may disappear before it is read.
WORDS = """() => {
  const button = document.querySelector("[data-steps] button.play");
  window.words = [];
  new MutationObserver(() => words.push(button.textContent)).observe(button, { childList: true });
}"""


def farthest(drawn: dict[str, list[float]], pose: np.ndarray) -> float:
    """Return the largest distance in m of a drawn body from its place in MuJoCo."""
    model = picture_model(TASK)
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    assert len(drawn) == model.nbody - 1
    return max(np.abs(data.body(name).xpos - place).max() for name, place in drawn.items())


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_page_bodies_match_mujoco(browser: Browser, episode: Episode, tmp_path: Path) -> None:
    write_episode(episode_content(episode), tmp_path / "page.html")
    for page in shown_in(browser, tmp_path / "page.html"):
        moved = []
        for step in (0, STEPS // 2, STEPS):
            drawn = page.evaluate(BODIES, step)
            assert farthest(drawn, episode.poses[step]) < 1e-4
            moved.append(drawn["robot_hand"])
            assert farthest(drawn, episode.poses[step] + 0.01) > 1e-3, "of another pose they differ"
        assert np.ptp(moved, axis=0).max() > 0.01
        content = page.evaluate(CONTENT)
        np.testing.assert_allclose(content["force"], episode.force, atol=1e-3)
        np.testing.assert_allclose(content["reward"], episode.reward, atol=1e-5)
        assert content["terms"].keys() == episode.terms.keys()
        for name, values in episode.terms.items():
            np.testing.assert_allclose(content["terms"][name], values, atol=1e-5)
        assert page.evaluate(COLOURS) > 100, "the scene is no empty picture"


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_page_handles_keys_and_shows_preferences(
    browser: Browser, episode: Episode, tmp_path: Path
) -> None:
    write_episode(episode_content(episode), tmp_path / "page.html")
    for page in shown_in(browser, tmp_path / "page.html", 400):
        slider, player = page.get_by_label("Moment of the episode"), page.locator("[data-steps]")
        worst = int(np.argmax(episode.force))
        assert episode.force[worst] > 2 * episode.preferences["force"]
        player.focus()
        for key, moment in (("ArrowRight", 1), ("End", STEPS), ("ArrowLeft", STEPS - 1)):
            page.keyboard.press(key)
            expect(slider).to_have_value(str(moment))
        page.keyboard.press("Home")
        for _ in range(worst):
            page.keyboard.press("ArrowRight")
        expect(page.get_by_text(f"{episode.force[worst]:.1f} N").first).to_be_visible()
        expect(page.locator(".episode-now").get_by_text("harder than preferred")).to_be_visible()
        expect(page.get_by_text("robot", exact=True).first).to_be_visible()
        page.evaluate(WORDS)
        page.keyboard.press(" ")
        expect(slider).to_have_value(str(STEPS), timeout=60_000)
        expect(page.get_by_role("button", name="Play")).to_be_visible()
        assert page.evaluate("window.words") == ["Pause", "Play"]
        assert page.evaluate("document.documentElement.scrollWidth") <= 400


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_person_page_names_preferences(browser: Browser, tmp_path: Path) -> None:
    shown = read_episode(record(tmp_path, "random", PERSON, 3))
    assert shown.about["version"] == VERSIONS[TASK]
    write_episode(episode_content(shown), tmp_path / "page.html")
    for page in shown_in(browser, tmp_path / "page.html"):
        who = page.locator(".episode-who")
        expect(who).to_contain_text(PERSON)
        expect(who).to_contain_text("its own: a person of the zoo")
        expect(who).to_contain_text(f"a touch of {shown.preferences['force']:.3g} N")


@pytest.mark.slow
@needs("chromium", CHROMIUM)
def test_without_webgl_the_curves_are_there(
    browser: Browser, episode: Episode, tmp_path: Path
) -> None:
    write_episode(episode_content(episode), tmp_path / "page.html")
    with opened(browser) as page:
        page.emulate_media(reduced_motion="reduce")
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null;")
        page.goto((tmp_path / "page.html").as_uri())
        expect(page.get_by_text("This browser cannot draw the scene")).to_be_visible()
        expect(page.locator("[data-curve=force] svg")).to_be_visible()


def test_every_task_and_wish_has_its_words():
    assert all(kind.goal for kind in REGISTERED.values())
    assert set(PREFERENCE_WORDS) >= {wish for wishes in PREFERRED.values() for wish in wishes}
