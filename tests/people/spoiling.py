"""Two hundred logs that are not consistent, each changed in one thing and signed anew.

So their hash is right, unless the hash itself is what was changed.
"""

import base64
import copy
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from tests.people.maker import encoded, signed

Content = dict[str, Any]
Change = Callable[[Content], None]


def spoiled(log: Content) -> Iterator[tuple[str, Content]]:
    """Yield a name and a content for each of the changes of a log with a robot that hears words."""
    for name, change in _changes():
        content = copy.deepcopy(log)
        change(content)
        yield name, content if name.startswith("hash") else signed(content)


def _changes() -> Iterator[tuple[str, Change]]:
    yield from _changed_actions()
    yield from _changed_words()
    yield from _changed_results()
    yield from _changed_hashes()
    yield from _changed_starts()
    yield from _changed_shapes()
    yield from _changed_fields()


def _changed_actions() -> Iterator[tuple[str, Change]]:
    rng = np.random.default_rng(0)
    for number in range(30):
        step, size = int(rng.integers(0, 900)), float(rng.choice([1e-4, 0.01, 0.5]))
        yield f"robot's action {number}", _acted("robot", step, size)
    for number in range(30):
        step = int(rng.integers(0, 800))
        yield f"human's action {number}", _acted("human", step, 0.2)
    for number, value in enumerate((np.nan, np.inf, -np.inf, 1.5, -1e30)):
        for seat in ("robot", "human"):
            yield f"{seat}'s number {number}", _acted(seat, 10 * number, value, put=True)


def _changed_words() -> Iterator[tuple[str, Change]]:
    rng = np.random.default_rng(1)
    for number in range(20):
        # Said words stand at steps 100, 250 and so on: neither they nor their echo are hit.
        step, word = 150 * int(rng.integers(0, 6)) + 30, int(rng.integers(1, 9))
        yield f"added word {number}", _said(step, word)
    for number, step in enumerate((100, 250, 400, 550, 700, 850)):
        yield f"taken word {number}", _said(step, 0)
    for number, code in enumerate((-1, 9, 127, -128)):
        yield f"unknown word {number}", _said(3, code)


def _changed_results() -> Iterator[tuple[str, Change]]:
    for number, by in enumerate((0.01, -0.01, 0.5, 10.0, 500.0, -500.0, 1e30, 1e308)):
        yield (
            f"return {number}",
            _put(lambda log, by=by: log["result"]["return"] + by, "result.return"),
        )
    for number, value in enumerate((None, "8", True, [], {}, 0)):
        yield f"kind of return {number}", _put(lambda log, value=value: value, "result.return")
    yield "success", _put(lambda log: not log["result"]["success"], "result.success")
    yield "success as number", _put(lambda log: 0, "result.success")
    for name, value in (
        *(("steps", 999), ("violation", "impact"), ("done_force", 3.0), ("within_force", 1.0)),
        *(("liked_force", 4.1), ("discomfort_share", 0.3), ("force_peak", 1.0), ("luck", 1.0)),
        *(("nonfinite", True), ("done_speed", 0.01)),
    ):
        yield f"figure {name}", _put(lambda log, value=value: value, f"result.{name}")
    yield "no return", lambda log: log["result"].pop("return")
    yield "no success", lambda log: log["result"].pop("success")


def _changed_hashes() -> Iterator[tuple[str, Change]]:
    yield "hash of the log", _put(lambda log: "0" * 64, "sha256")
    yield "hash of capitals", _put(lambda log: log["sha256"].upper() + "A", "sha256")
    yield "hash is short", _put(lambda log: log["sha256"][:63], "sha256")
    yield "hash is missing", lambda log: log.pop("sha256")
    yield "hash and date", _put(lambda log: "2026-11-30T10:00:00Z", "saved")
    yield "hash and start", _put(lambda log: log["start"] + 1, "start")
    yield "robot's sha256", _put(lambda log: "1" * 64, "robot.sha256")
    yield "robot without sha256", _put(lambda log: None, "robot.sha256")
    other = "gentle_scratch/dagger-ego-s1-v1/robot"
    for number, name in enumerate(
        (other, "script", "gentle_scratch/*/robot", "nobody", "", "x" * 300, "../../etc/passwd")
    ):
        yield f"robot's name {number}", _put(lambda log, name=name: name, "robot.name")


def _changed_starts() -> Iterator[tuple[str, Change]]:
    for number, start in enumerate((0, 1, 4, 6, 63, 64, 2**32, -1, 2**70, 5.5, "5", None)):
        yield f"start {number}", _put(lambda log, start=start: start, "start")
    for number, force in enumerate((2.0, 3.9, 4.1, 8.0, 0.0, -4.0, 1e9, "4", None)):
        yield f"wish {number}", _put(lambda log, force=force: force, "wish.force")
    yield "no wish", lambda log: log["wish"].pop("speed")
    yield "wish of another task", _put(lambda log: 0.08, "wish.wait")


def _changed_shapes() -> Iterator[tuple[str, Change]]:
    for steps in (999, 1001, 500, 1, 0, -1, 10**9):
        yield f"steps {steps}", _put(lambda log, steps=steps: steps, "steps")
    for kept in (999, 500, 1):
        yield f"only {kept} steps", _shortened(kept)
    for name in ("actions.robot", "actions.human", "words"):
        yield f"short {name}", _put(lambda log, name=name: _get(log, name)[:-8], name)
        yield f"empty {name}", _put(lambda log: "", name)
        yield f"no base64 {name}", _put(lambda log: "*" * 40, name)
        yield f"huge {name}", _put(lambda log: "A" * 400_000, name)
        yield f"list {name}", _put(lambda log: [0.0] * 8, name)


def _changed_fields() -> Iterator[tuple[str, Change]]:
    values = {
        "format": ("assistax-seat 2", "", None, 1),
        "task": ("gentle_bath", "scratch", "nothing", None),
        "environment": (3, 5, -1, "4", None),
        "device.kind": ("joystick",),
        "device.class": ("watch",),
        "device.width": (0, 10**7, 2.5),
        "dropped": (-1, 1e9, "0"),
        "saved": ("yesterday", 5, "2" * 100),
        "study.block": (0, "1"),
        "consent": ([True, True, False], [True, True], [1, 1, 1], True),
        "engine": ("abc", None, "0" * 64),
        "extra": (1,),
    }
    for name, wrong in values.items():
        for number, value in enumerate(wrong):
            yield f"{name} {number}", _put(lambda log, value=value: value, name)


def _get(log: Content, name: str) -> Any:
    for key in name.split("."):
        log = log[key]
    return log


def _put(value: Callable[[Content], Any], name: str) -> Change:
    """Return the change that sets a field to a value, which may depend on the log."""

    def change(log: Content) -> None:
        *outer, last = name.split(".")
        found = value(log)
        inner = _get(log, ".".join(outer)) if outer else log
        inner[last] = found

    return change


def _array(log: Content, seat: str) -> np.ndarray:
    data = base64.b64decode(log["actions"][seat])
    return np.frombuffer(data, "<f4").reshape(log["steps"], -1).copy()


def _acted(seat: str, step: int, value: float, *, put: bool = False) -> Change:
    """Return the change of a number of an action, by a value or to a value."""

    def change(log: Content) -> None:
        actions = _array(log, seat)
        old = actions[step, 1]
        actions[step, 1] = value if put else old - np.sign(old + 1e-9) * value
        log["actions"][seat] = encoded(actions, "<f4")

    return change


def _said(step: int, word: int) -> Change:
    """Return the change of the word of a step."""

    def change(log: Content) -> None:
        words = np.frombuffer(base64.b64decode(log["words"]), "i1").copy()
        words[step] = word
        log["words"] = encoded(words, "i1")

    return change


def _shortened(kept: int) -> Change:
    """Return the change that keeps the first steps alone, in every field."""

    def change(log: Content) -> None:
        for seat in ("robot", "human"):
            log["actions"][seat] = encoded(_array(log, seat)[:kept], "<f4")
        log["words"] = encoded(np.frombuffer(base64.b64decode(log["words"]), "i1")[:kept], "i1")
        log["steps"] = kept

    return change
