"""Tasks are found by name: our own, and those of installed packages, without JAX."""

import ast
import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from assistax_base.extensions import TASKS as GROUP
from assistax_base.extensions import ExtensionError
from assistax_envs import make
from assistax_envs.models.build import scene_sha256
from assistax_envs.preferences import PREFERRED, VALUES
from assistax_envs.registered import OURS, REGISTERED, TASK_CLASSES
from assistax_envs.tasks.chain import SCRIPTS, script_of
from assistax_envs.tasks.kind import Scene
from assistax_envs.tasks.scratch import TASK as SCRATCH
from assistax_envs.tasks.scratch.task import Scratch
from assistax_envs.versions import CARE_TASKS, GENTLE_TASKS, PAPER_TASKS, TASKS, VERSIONS

ROOT = Path(__file__).parents[2]
PACKAGES = ("assistax_envs", "population", "zoo", "evaluation", "assistax_zoo", "workshop", "board")


class Mine(Scratch):
    name = scene = "mine"


TEXT = resources.files("assistax_envs.tasks.scratch").joinpath("scene.xml").read_text()
MINE = dataclasses.replace(
    SCRATCH, name="mine", version=7, make=f"{__name__}:Mine", scene=Scene(TEXT)
)


@pytest.fixture
def outside(install_package: Callable[..., None], monkeypatch: pytest.MonkeyPatch):
    """Return a function that installs packages of one task each: names and places."""

    def give(*places: tuple[str, str]) -> None:
        # Kinds are loaded once a process: the test loads others.
        monkeypatch.setattr(REGISTERED, "_kinds", {})
        for number, (name, place) in enumerate(places):
            install_package(GROUP, name, place, package=f"lab{number}")

    return give


def test_tables_have_every_task_in_order() -> None:
    tables = (TASKS, VERSIONS, TASK_CLASSES, SCRIPTS)
    assert all(tuple(table) == tuple(REGISTERED) for table in tables)
    assert (*PAPER_TASKS, *GENTLE_TASKS, *CARE_TASKS) == OURS == TASKS[: len(OURS)]
    assert tuple(PREFERRED) == (*GENTLE_TASKS, *CARE_TASKS)


@pytest.mark.parametrize("task", REGISTERED)
def test_kind_names_what_exists(task: str) -> None:
    kind = REGISTERED[task]
    assert TASK_CLASSES[task].name == TASK_CLASSES[task].scene == kind.name == task
    assert (resources.files("assistax_envs.models") / f"{kind.tool}.xml").is_file()
    assert set(kind.preferences) <= set(VALUES) and kind.goal.endswith(".")


def test_kind_refuses_unknown_preferences() -> None:
    with pytest.raises(ValueError, match="mine has preferences about taste; allowed are force"):
        dataclasses.replace(MINE, preferences=("taste",))


def test_outside_task_plays_with_scene_and_script(outside) -> None:
    outside(("mine", f"{__name__}:MINE"))
    assert tuple(REGISTERED) == (*OURS, "mine") and VERSIONS["mine"] == 7
    env = make("mine", "native")
    assert (env.task, env.version) == ("mine", 7)
    assert scene_sha256("mine") == scene_sha256("scratch")
    obs = jnp.asarray(np.random.default_rng(0).normal(size=(2, 34)), jnp.float32)
    np.testing.assert_array_equal(
        script_of("mine", env.model)(obs), script_of("scratch", env.model)(obs)
    )


@pytest.mark.parametrize(
    ("places", "message"),
    [
        ([("scratch", "lab.tasks:TASK")], "name of its own, found that of a task of assistax-zoo"),
        ([("a", "one:TASK"), ("a", "two:TASK")], "package lab1 .* that of a task of lab0"),
        ([("mine", "no_such_module:TASK")], "package lab0 .* found ModuleNotFoundError: "),
        ([("mine", f"{__name__}:TEXT")], "'mine' of the package lab0 .* TaskKind .*, found str"),
        ([("other", f"{__name__}:MINE")], "'other' of the package lab0 .* found a task 'mine'"),
    ],
)
def test_bad_entry_names_its_package(outside, places, message: str) -> None:
    with pytest.raises(ExtensionError, match=message):
        outside(*places)
        [REGISTERED[name] for name in REGISTERED]


def test_kinds_load_without_jax() -> None:
    code = (
        "import json, sys, assistax_envs.versions as v, assistax_envs.preferences; dict(v.VERSIONS)"
        "; print(json.dumps(sorted({'jax', 'mujoco'} & set(sys.modules))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == []


def membership_tests(source: str) -> list[int]:
    """Return the lines that ask whether a task is one of some tasks by name."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Compare)
        for right in node.comparators
        if isinstance(right, ast.Name) and right.id in ("CARE_TASKS", "GENTLE_TASKS", "PAPER_TASKS")
    ]


def test_no_module_asks_for_a_group_of_tasks() -> None:
    assert membership_tests("if task not in GENTLE_TASKS:\n    pass") == [1]  # planted
    lines = {
        str(path.relative_to(ROOT)): numbers
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if (numbers := membership_tests(path.read_text(encoding="utf-8")))
    }
    assert lines == {}


def test_class_of_an_unknown_scene_is_refused() -> None:
    class Lost(Scratch):
        name, scene = "lost", "nowhere"

    with pytest.raises(ValueError, match="there is no scene 'nowhere'; set the class's `scene`"):
        make(Lost, "native")
