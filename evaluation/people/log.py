"""The log of an episode that a visitor of the browser page played: one JSON file, not trusted.

The file is bounded before it is parsed, and every field is checked. What a log says of an episode
is then compared with the episode played again, see `evaluation.people.replaying`. No log proves
that a person played: a program can press the same keys.
"""

import base64
import binascii
import dataclasses
import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator, model_validator

from assistax_base.bounded_reading import parse_json
from assistax_base.digest import json_sha256
from assistax_base.errors import printable, shorten
from assistax_base.validated import first_problem
from assistax_envs.persons.rows import PARAMETERS, person_kind
from assistax_envs.preferences import PREFERRED, VALUES, WORDS
from assistax_envs.versions import VERSIONS
from evaluation.figures.normalised import SCRIPT
from evaluation.seat.modules import playable, read_manifest
from zoo.schema import Sha256, StrictModel

FORMAT = "assistax-seat 1"
LARGEST_LOG = 1 << 18  # bytes; a log of 1000 steps has 70 to 90 thousand
MOST_VALUES = 500  # commas
STEPS = 1000  # of a whole episode
STARTS = 64  # seeds of the page's starts are 0 to 63
ROBOT_TORQUES = 7
WITH_WISHES = "told-script"  # the task's script that is told the wish
PAGE = "save the episode again on the page of this version of assistax-zoo"

_Name = Annotated[str, Field(min_length=1, max_length=200)]
_Text = Annotated[str, Field(max_length=65_536)]  # base64 of 1000 steps of 7 float32 has 37,336
_Pixels = Annotated[int, Field(ge=1, le=20_000)]
_Figure = bool | int | float | str | None


class LogError(ValueError):
    """A log that is refused."""


class Robot(StrictModel):
    """The robot of an episode."""

    name: _Name  # an id of the registry, SCRIPT or WITH_WISHES
    sha256: Sha256 | None  # of its parameters; None for a script


class Study(StrictModel):
    """Place of an episode in a study; without a study only `blind` is set."""

    blind: bool  # whether the visitor was not told which robot it was
    block: Annotated[int, Field(ge=1, le=10_000)] | None
    order: Annotated[tuple[_Name, ...], Field(strict=False, max_length=20)] | None


class Device(StrictModel):
    """Screen and input of an episode."""

    width: _Pixels
    height: _Pixels
    kind: Literal["mouse", "touch", "keyboard"]
    class_: Annotated[Literal["phone", "tablet", "desktop"], Field(alias="class")]


class Actions(StrictModel):
    """Actions of both seats, base64 of little-endian float32."""

    robot: _Text
    human: _Text


class SeatLog(StrictModel):
    """Content of a log."""

    format: Literal["assistax-seat 1"]
    task: _Name
    environment: int  # the version of the task's environment
    engine: Sha256  # of the page's module of the task
    robot: Robot
    study: Study
    start: Annotated[int, Field(ge=0, lt=STARTS)]  # seed of the reset
    wish: Annotated[dict[_Name, Annotated[float, Field(gt=0)]], Field(max_length=8)]
    device: Device
    dropped: Annotated[int, Field(ge=0, le=10_000_000)]  # frames that were not drawn in time
    steps: Annotated[int, Field(ge=1, le=STEPS)]
    actions: Actions
    words: Annotated[str, Field(max_length=4_096)]  # base64 of int8
    result: Annotated[dict[_Name, _Figure], Field(max_length=80)]
    saved: Annotated[str, Field(max_length=40)]  # ISO date
    consent: Annotated[tuple[bool, bool, bool], Field(strict=False)]  # the three ticks
    sha256: Sha256  # of the canonical JSON of everything else

    @field_validator("wish", mode="before")
    @classmethod
    def _numbers(cls, wish: Any) -> Any:
        """Return the wish with floats: a page writes 2.0 as 2."""
        if not isinstance(wish, dict):
            return wish
        return {key: float(v) if type(v) is int else v for key, v in wish.items()}

    @field_validator("saved")
    @classmethod
    def _date(cls, saved: str) -> str:
        try:
            datetime.datetime.fromisoformat(saved)
        except ValueError:
            raise ValueError(f"{shorten(saved)} is no date; it must be ISO 8601") from None
        return saved

    @field_validator("consent", mode="before")
    @classmethod
    def _ticked(cls, consent: Any) -> Any:
        if not isinstance(consent, list) or not all(tick is True for tick in consent):
            raise ValueError(f"{shorten(consent)}; three ticks, each true, release an episode")
        return consent

    @model_validator(mode="after")
    def _fits(self) -> "SeatLog":
        if self.task not in playable():
            allowed = ", ".join(playable())
            raise ValueError(f"task is {shorten(self.task)}; a seat exists in {allowed}")
        if self.environment != VERSIONS[self.task]:
            raise ValueError(
                f"environment is version {self.environment} of {self.task}; this installation "
                f"plays version {VERSIONS[self.task]}"
            )
        module = read_manifest()["tasks"][self.task]["wasm"]
        if self.engine != module:
            raise ValueError(
                f"engine is the program {self.engine}; the page of this version plays {self.task} "
                f"with {module}"
            )
        _check_wish(self.task, self.wish)
        if (self.robot.sha256 is None) != (self.robot.name in (SCRIPT, WITH_WISHES)):
            raise ValueError(
                f"robot {shorten(self.robot.name)} has sha256 {self.robot.sha256}; {SCRIPT} and "
                f"{WITH_WISHES} have none, and every other robot has one"
            )
        return self


@dataclasses.dataclass(frozen=True)
class Recorded:
    """A log with its actions as arrays of T steps."""

    path: Path
    log: SeatLog
    robot: np.ndarray  # [T, 7] float32, shares of the torque limits
    human: np.ndarray  # [T, 3] float32, at the mouth [T, 5]
    words: np.ndarray  # [T] int8, codes of `preferences.WORDS`; 0 for silence

    @property
    def sha256(self) -> str:
        """The log's hash, which names it."""
        return self.log.sha256


def read_log(path: Path) -> Recorded:
    """Return the content of an untrusted log.

    Raises:
        LogError: The file is no log, or a field of it is not allowed.
    """
    try:
        if not path.is_file():
            raise LogError("it is no file; give a log that the page saved")
        with path.open("rb") as file:
            data = file.read(LARGEST_LOG + 1)
        return parse_log(data, path)
    except OSError as error:
        raise LogError(f"{path} cannot be read ({error.strerror}); give another file") from None
    except LogError as error:
        raise LogError(printable(f"{path}: {error}")) from None


def parse_log(data: bytes, path: Path) -> Recorded:
    """Return the content of the bytes of an untrusted log; `path` names it.

    Raises:
        LogError: The bytes are no log, or a field is not allowed.
    """
    if len(data) > LARGEST_LOG:
        raise LogError(f"it has more than {LARGEST_LOG} bytes, and no log has; {PAGE}")
    try:
        content = parse_json(data.decode("utf-8"), MOST_VALUES)
    except (ValueError, RecursionError) as error:
        raise LogError(f"it is no JSON of a log ({shorten(str(error))}); {PAGE}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise LogError(f"its format is {shorten(found)}; {FORMAT!r} is read; {PAGE}")
    try:
        log = SeatLog.model_validate(content)
    except ValidationError as error:
        raise LogError(f"{first_problem(error)}; {PAGE}") from None
    found = json_sha256({key: value for key, value in content.items() if key != "sha256"})
    if found != log.sha256:
        raise LogError(
            f"its sha256 is {log.sha256}, and its content has {found}: it was changed after it was "
            "saved; take the file that the page saved"
        )
    return Recorded(path, log, *_arrays(log))


def _check_wish(task: str, wish: dict[str, float]) -> None:
    """Refuse a wish that is not of the task, or that no person has."""
    if set(wish) != set(PREFERRED[task]):
        raise ValueError(
            f"wish is about {shorten(sorted(wish))}; in {task} it is about "
            f"{' and '.join(PREFERRED[task])}"
        )
    ranges = {parameter.name: parameter for parameter in PARAMETERS[task]}
    for name, value in wish.items():
        number = ranges[f"liked_{name}"]
        low, high = min(number.low, *VALUES[name]), max(number.high, *VALUES[name])
        if not low <= value <= high:
            raise ValueError(
                f"wish {name} is {value:g} {number.unit}; allowed are {low:g} to {high:g}"
            )


def _arrays(log: SeatLog) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the actions of robot and human, and the words, checked."""
    _, human_torques = person_kind(log.task).seat_size
    robot = _decoded(log.actions.robot, "<f4", (log.steps, ROBOT_TORQUES), "robot's actions")
    human = _decoded(log.actions.human, "<f4", (log.steps, human_torques), "human's actions")
    for name, values in (("robot", robot), ("human", human)):
        if not (np.abs(values) <= 1.0).all():  # NaN is not
            raise LogError(f"an action of the {name} is not in [-1, 1]; {PAGE}")
    words = _decoded(log.words, "i1", (log.steps,), "words")
    if words.min() < 0 or words.max() > len(WORDS):
        raise LogError(
            f"words hold the codes {words.min()} to {words.max()}; allowed are 0 for silence and "
            f"1 to {len(WORDS)}; {PAGE}"
        )
    return robot, human, words


def _decoded(text: str, kind: str, shape: tuple[int, ...], what: str) -> np.ndarray:
    """Return the array of a base64 text."""
    try:
        data = base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise LogError(f"the {what} are no base64 ({error}); {PAGE}") from None
    expected = int(np.prod(shape)) * np.dtype(kind).itemsize
    if len(data) != expected:
        raise LogError(
            f"the {what} have {len(data)} bytes; {shape[0]} steps have {expected}; {PAGE}"
        )
    return np.frombuffer(data, kind).reshape(shape).astype(kind.removeprefix("<"))
