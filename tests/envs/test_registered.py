"""A task is registered in one place, which is read without JAX."""

import ast
import json
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

from assistax_envs import make
from assistax_envs.gentle_scripts import SCRIPTS
from assistax_envs.preferences import VALUES, WISHES
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks import TASK_CLASSES
from assistax_envs.tasks.scratch import Scratch
from assistax_envs.versions import CARE_TASKS, GENTLE_TASKS, PAPER_TASKS, TASKS, VERSIONS

ROOT = Path(__file__).parents[2]
PACKAGES = ("assistax_envs", "population", "zoo", "evaluation", "assistax_zoo", "workshop", "board")


def test_every_table_of_tasks_is_the_registered_one() -> None:
    tables = (TASKS, VERSIONS, TASK_CLASSES, SCRIPTS)
    assert all(tuple(table) == tuple(REGISTERED) for table in tables)
    assert (*PAPER_TASKS, *GENTLE_TASKS, *CARE_TASKS) == TASKS
    assert tuple(WISHES) == (*GENTLE_TASKS, *CARE_TASKS)


@pytest.mark.parametrize("task", REGISTERED)
def test_a_row_names_what_there_is(task: str) -> None:
    row = REGISTERED[task]
    assert TASK_CLASSES[task].name == task
    assert (resources.files("assistax_envs.models") / f"{row.tool}.xml").is_file()
    assert set(row.wishes) <= set(VALUES)


def test_tasks_are_known_without_jax() -> None:
    code = (
        "import json, sys; import assistax_envs.registered, assistax_envs.versions, "
        "assistax_envs.preferences; print(json.dumps(sorted({'jax', 'mujoco'} & set(sys.modules))))"
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


def test_nobody_asks_for_a_task_by_its_kind() -> None:
    assert membership_tests("if task not in GENTLE_TASKS:\n    pass") == [1]  # planted
    lines = {
        str(path.relative_to(ROOT)): numbers
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if (numbers := membership_tests(path.read_text(encoding="utf-8")))
    }
    assert lines == {}


def test_a_class_without_a_scene_is_refused_with_what_to_do() -> None:
    class Mine(Scratch):
        name = "mine"

    with pytest.raises(ValueError, match="there is no scene 'mine'; set the class's `scene`"):
        make(Mine, "native")
