"""Read an episode of an untrusted recorded table, and convert it for the player's page.

Sizes, shapes and numbers are checked before they are used.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import polars as pl

from assistax_base.bounded_reading import parse_json
from assistax_base.errors import printable, shorten
from assistax_base.files import METADATA_KEY
from assistax_base.parquet import check_readable, check_size, read_metadata, read_parquet
from assistax_envs.disability import DISABILITY_SETTINGS, Disability
from assistax_envs.drawing.overlay import LEVELS, MEANINGS
from assistax_envs.drawing.render import picture_model, pressing
from assistax_envs.env import EPISODE_LENGTH
from assistax_envs.physics import SUBSTEPS
from assistax_envs.preferences import HEARD, PREFERRED, WORDS
from assistax_envs.registered import REGISTERED, TASK_CLASSES
from evaluation.player.scene import scene_content

LARGEST_FILE = 256 * 1024 * 1024  # bytes
LARGEST_ABOUT = 1024 * 1024  # characters of a file's metadata
LARGEST_VALUE = 1e5  # of any number that is shown: N, m, rad
MOST_TARGETS, MOST_TERMS = 64, 32
LONGEST_NAME = 200  # characters
# Factor, unit and words of each quantity that a person may prefer.
PREFERENCE_WORDS = {
    "force": (1.0, "N", "a touch of {} N"),
    "speed": (100.0, "cm/s", "strokes at {} cm/s"),
    "distance": (100.0, "cm", "the hook {} cm away once the arm lies"),
    "place": (100.0, "cm", "the arm {} cm across the waist"),
    "wait": (100.0, "cm", "the tool waits {} cm before the mouth"),
    "depth": (1000.0, "mm", "the tool {} mm deep in the mouth"),
    "press": (1.0, "N", "the brush at {} N"),
}
LEVEL_WORDS = ("a gentle touch", "more than a gentle touch", "more than a frail face bears")


@dataclasses.dataclass(frozen=True)
class Episode:
    """One recorded episode up to its end: T moments, of which the first has no reward yet."""

    about: Mapping[str, Any]  # task, robot, person, version, seed, setting, number
    poses: np.ndarray  # [T, nq] rad
    velocities: np.ndarray  # [T, nq] rad/s
    targets: dict[str, np.ndarray]  # name -> [T, 3 K] m, NaN where one is not shown
    preferences: dict[str, float]
    force: np.ndarray  # [T] N
    speed: np.ndarray | None  # [T] m/s
    reward: np.ndarray  # [T]
    terms: dict[str, np.ndarray]  # name -> [T]
    stopped: bool  # by a protective stop
    said: np.ndarray | None = None  # [T] codes of words said before each moment; None without words


def read_episode(path: Path, number: int = 0) -> Episode:
    """Return one episode of an untrusted file of `trajectories`.

    Raises:
        ValueError: The file is damaged, too large, or lacks data that a player shows.
    """
    if not path.is_file():
        raise ValueError(f"there is no file {path}; give one that `trajectories` wrote")
    if (size := path.stat().st_size) > LARGEST_FILE:
        raise ValueError(f"{path} has {size} bytes; at most {LARGEST_FILE} are read")
    check_size(path)
    check_readable([path])
    table = read_parquet(path)
    try:
        return _episode(table, _about(path), number)
    except _UnplayableError as error:
        raise ValueError(
            f"{path} cannot be played ({printable(str(error))}); record it anew with "
            "`assistax-zoo trajectories`"
        ) from None


def episode_content(episode: Episode) -> dict[str, Any]:
    """Return the page's data of an episode, JSON-ready: names and finite numbers."""
    about, task = episode.about, TASK_CLASSES[episode.about["task"]]
    scene = scene_content(scene_of(episode), f"human {about['person']}")
    camera, points = scene["camera"], next(iter(episode.targets.values()))[:, :3]
    middle = points[np.isfinite(points).all(axis=1)]
    towards = (middle.mean(axis=0) if len(middle) else np.zeros(3)) - camera["pos"]
    camera["distance"] = max(1.0, float(towards @ camera["towards"]))
    hurts = episode.terms.get("violation", np.zeros(len(episode.reward))) < 0.0
    return {
        "task": about["task"],
        "robot": about["robot"],
        "person": about["person"],
        "facts": _facts(episode),
        "scene": scene,
        "seconds": seconds_of(episode),
        "poses": _numbers(episode.poses, 5),
        "targets": [
            {
                "label": MEANINGS.get(name, name),
                "colour": _hex(255 * np.array(task.target_colours[name][:3])),
                "points": _numbers(points, 4),
            }
            for name, points in episode.targets.items()
        ],
        "touches": _touches(episode),
        "preferences": [
            {
                "name": name,
                "value": value,
                "scale": PREFERENCE_WORDS[name][0],
                "unit": PREFERENCE_WORDS[name][1],
            }
            for name, value in episode.preferences.items()
        ],
        "force": _numbers(episode.force, 3),
        "hurts": hurts.tolist(),
        "speed": None if episode.speed is None else _numbers(episode.speed, 4),
        "distance": _numbers(_gaps(episode), 4) if "distance" in episode.preferences else None,
        "rests": (episode.terms.get("rest", np.zeros(len(episode.reward))) > 0.0).tolist(),
        "words": _heard(episode),
        "reward": _numbers(episode.reward, 5),
        "terms": {name: _numbers(values, 5) for name, values in episode.terms.items()},
        "levels": [
            {"from": least, "colour": _hex(colour), "label": words}
            for (least, colour), words in zip(LEVELS, LEVEL_WORDS, strict=True)
        ],
    }


def scene_of(episode: Episode) -> str:
    """Return the name of an episode's scene, which is that of a task."""
    return episode.about["task"]


def seconds_of(episode: Episode) -> float:
    """Return the length of a step in seconds."""
    return SUBSTEPS * float(picture_model(scene_of(episode)).opt.timestep)


def is_felt(episode: Episode) -> bool:
    """Return whether the recorded force is that of all contacts, not only of tool and arm."""
    return REGISTERED[episode.about["task"]].felt


class _UnplayableError(Exception):
    """A table lacks data that a player shows; the message names it."""


def _about(path: Path) -> dict[str, Any]:
    """Return task, policies, version and seed from the file's metadata, checked."""
    text = read_metadata(path).get(METADATA_KEY, "")
    try:
        about = parse_json(text if len(text) <= LARGEST_ABOUT else "")
        robot, person = (str(about[role]["policy"]) for role in ("robot", "human"))
        task, version = str(about["task"]), int(about["environment_version"])
        known = {"seed": int(about["seed"]), "setting": _setting(about["disability"])}
    except (ArithmeticError, LookupError, TypeError, ValueError, RecursionError):
        raise _UnplayableError("its metadata does not say who plays what") from None
    if task not in REGISTERED:
        raise _UnplayableError(f"its task is {shorten(task)}; known are {', '.join(REGISTERED)}")
    if max(len(robot), len(person)) > LONGEST_NAME:
        raise _UnplayableError(f"a policy's name has more than {LONGEST_NAME} characters")
    names = {"robot": printable(robot), "person": printable(person)}
    return {"task": task, "version": version, **names, **known}


def _setting(described: Any) -> str:
    """Return a disability setting as text, with its name if it has one."""
    if described is None:
        return "its own: a person of the zoo"
    names = {dataclasses.astuple(setting): name for name, setting in DISABILITY_SETTINGS.items()}
    fields = [field.name for field in dataclasses.fields(Disability)]
    setting = DISABILITY_SETTINGS[described] if isinstance(described, str) else None
    values = [float(described[name]) for name in fields] if setting is None else []
    setting = setting or Disability(*values)
    words = (
        f"{setting.strength:.0%} of its strength, {setting.elbow_range:.0%} of its elbow's range"
    )
    words += f", tremor {setting.tremor:.0%}" if setting.tremor else ""
    name = names.get(dataclasses.astuple(setting))
    return f"{name}: {words}" if name else words


def _episode(table: pl.DataFrame, about: Mapping[str, Any], number: int) -> Episode:
    task = TASK_CLASSES[about["task"]]
    joints = picture_model(about["task"]).nq
    if "episode" not in table.columns or "pose" not in table.columns:
        raise _UnplayableError("it has no poses: an older version recorded it")
    rows = table.filter(pl.col("episode") == number)
    if not 2 <= rows.height <= EPISODE_LENGTH + 1:
        found = f"episode {number} has {rows.height} rows"
        raise _UnplayableError(f"{found}; it must have 2 to {EPISODE_LENGTH + 1}")
    stops = _column(rows, "terminated", last=False).astype(bool)
    count = int(stops.argmax()) + 1 if stops.any() else len(stops)  # steps that count
    rows = rows.head(count + 1)
    targets = [name for name in task.target_colours if f"target_{name}" in rows.columns]
    terms = [name for name in rows.columns if name.startswith("term_")][:MOST_TERMS]
    if not targets:
        raise _UnplayableError("it has no targets")

    def gained(name: str) -> np.ndarray:
        return np.concatenate([[0.0], _column(rows, name, last=False)[:count]])

    return Episode(
        about={**about, "number": number},
        poses=_column(rows, "pose", joints),
        velocities=_column(rows, "velocity", joints),
        targets={name: _column(rows, f"target_{name}", -1) for name in targets},
        preferences={name: _preferred(rows, name) for name in PREFERRED.get(about["task"], ())},
        force=gained("force"),
        speed=gained("speed") if "speed" in rows.columns else None,
        reward=gained("reward"),
        terms={name.removeprefix("term_"): gained(name) for name in terms},
        stopped=bool(stops.any()),
        said=_said(gained("word")) if "word" in rows.columns else None,
    )


def _said(codes: np.ndarray) -> np.ndarray:
    """Return checked codes of words."""
    if not np.isin(codes, np.arange(len(WORDS) + 1)).all():
        raise _UnplayableError("its column word has codes that no word has")
    return codes.astype(int)


def _column(rows: pl.DataFrame, name: str, width: int = 0, *, last: bool = True) -> np.ndarray:
    """Return a column's numbers [T], or [T, width] for arrays, without the last row unless `last`.

    Points, of any width that is a multiple of 3, are asked for by -1: theirs alone may be NaN.
    """
    series = rows.get_column(name, default=None)
    if series is None:
        raise _UnplayableError(f"it has no column {name}")
    if not last:
        series = series.head(rows.height - 1)
    found = series.dtype.shape[0] if isinstance(series.dtype, pl.Array) else 0
    fits = found % 3 == 0 and 0 < found <= 3 * MOST_TARGETS if width < 0 else found == width
    inner = series.dtype.inner if isinstance(series.dtype, pl.Array) else series.dtype
    if not fits or not (inner.is_numeric() or inner == pl.Boolean) or series.null_count():
        raise _UnplayableError(f"its column {name} is {series.dtype} or has empty places")
    values = np.asarray(series.to_numpy(), float)
    allowed = np.abs(values) <= LARGEST_VALUE
    if width < 0:
        allowed |= np.isnan(values)
    if not allowed.all():
        raise _UnplayableError(f"its column {name} has numbers that no episode has")
    return values


def _preferred(rows: pl.DataFrame, name: str) -> float:
    values = _column(rows, f"wish_{name}")
    if values[0] <= 0.0 or (values != values[0]).any():
        raise _UnplayableError(f"the person's preference of {name} changes, or is not above 0")
    return float(values[0])


def _facts(episode: Episode) -> list[tuple[str, str]]:
    """Return the facts that are listed beside the scene, as pairs of name and text."""
    about = episode.about
    preferences = [
        PREFERENCE_WORDS[name][2].format(_short(name, v)) for name, v in episode.preferences.items()
    ]
    steps = len(episode.reward) - 1
    end = "" if steps == EPISODE_LENGTH else ", where the recording ends"
    end = ", then a protective stop: the person was hurt" if episode.stopped else end
    return [
        ("robot", about["robot"]),
        ("person", about["person"]),
        ("body", about["setting"]),
        ("prefers", ", ".join(preferences) or "people of this task have no preferences"),
        *([] if episode.said is None else [("says", _counted(episode.said))]),
        ("task", f"{about['task']}, version {about['version']}. {REGISTERED[about['task']].goal}"),
        ("episode", f"{about['number']} of seed {about['seed']}, {steps} steps{end}"),
    ]


def _heard(episode: Episode) -> list[str] | None:
    """Return the word that is heard at each moment, "" in silence; None without words."""
    if episode.said is None:
        return None
    heard, word, left = [], "", 0
    for code in episode.said:
        word, left = (WORDS[code - 1], HEARD) if code else (word, max(left - 1, 0))
        heard.append(word if left else "")
    return heard


def _counted(said: np.ndarray) -> str:
    """Return how often each word was said, as text."""
    counts = [(word, int((said == code).sum())) for code, word in enumerate(WORDS, 1)]
    return ", ".join(f"{word} {count}×" for word, count in counts if count) or "nothing"


def _short(name: str, value: float) -> str:
    return f"{value * PREFERENCE_WORDS[name][0]:.3g}"


def _touches(episode: Episode) -> list[list[list[float]]]:
    """Return each moment's contacts of the robot: place in m, direction, and force in N."""
    model = picture_model(scene_of(episode))
    data, touches = mujoco.MjData(model), []
    rows = zip(episode.poses, episode.velocities, episode.force, strict=True)
    for pose, velocity, newtons in rows:
        if newtons <= 0.0:
            touches.append([])
            continue
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = pose, velocity
        mujoco.mj_forward(model, data)
        pressed = np.column_stack(pressing(model, data, newtons, felt=is_felt(episode)))
        touches.append(_numbers(pressed[pressed[:, 6] > 0.0], 4))
    return touches


def _gaps(episode: Episode) -> np.ndarray:
    """Return the distance of the tool from the first target [T], in m."""
    model = picture_model(scene_of(episode))
    data, tools = mujoco.MjData(model), []
    for pose in episode.poses:
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        tools.append(data.sensor("robot_end_effector_position").data.copy())
    points = next(iter(episode.targets.values()))[:, :3]
    return np.linalg.norm(np.nan_to_num(points) - tools, axis=1)


def _numbers(values: np.ndarray, digits: int) -> list[Any]:
    """Return rounded numbers as lists, null for NaN."""
    rounded = (np.round(values, digits) + 0.0).astype(object)
    rounded[~np.isfinite(values)] = None
    return rounded.tolist()


def _hex(colour: Any) -> str:
    red, green, blue = (round(float(channel)) for channel in colour)
    return f"#{red:02x}{green:02x}{blue:02x}"
