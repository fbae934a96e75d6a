"""The page's file: small, whole, and closed to everything else."""

import base64
import json
import re
import subprocess
import zlib
from importlib import resources
from pathlib import Path

import pytest

from assistax_base.digest import json_sha256
from evaluation.seat.modules import playable, read_module
from evaluation.seat.page import (
    OWN,
    SCRIPTS,
    Robot,
    default_robots,
    network_of,
    page_content,
    published,
    write_page,
)
from tests.seat.trajectories import NODE
from tests.system import needs
from zoo.registry import load_registry

LARGEST = 1_000_000  # bytes of a page with the robots that it has by default
MOST_LINES = 1_500


@pytest.mark.slow_for("bath", "lift", "brushing", "feeding")
@pytest.mark.parametrize("task", playable())
def test_a_page_is_small_and_closed(task: str, tmp_path: Path) -> None:
    registry, network, path = load_registry(), network_of(task), tmp_path / "page.html"
    robots = published(registry, default_robots(registry, task, network), network)
    assert [one.name for one in robots[:2]] == list(SCRIPTS)
    write_page(task, robots, path)
    assert path.stat().st_size < LARGEST
    text = path.read_text()
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy and policy[1].startswith("default-src &#39;none&#39;")


def test_a_page_holds_its_module_and_its_robots() -> None:
    task, registry = "gentle_scratch", load_registry()
    (robot,) = published(
        registry, default_robots(registry, task, network_of(task))[2:], network_of(task)
    )
    data = zlib.decompress(page_content(task, [Robot("script"), robot]))
    size = int.from_bytes(data[:4], "little")
    header = json.loads(data[4 : 4 + size])

    def part(name: str) -> bytes:
        offset, length = header["parts"][name]
        return data[4 + size + offset :][:length]

    assert part("wasm") == read_module(task)["wasm"]
    assert robot.params and part("robot1") == robot.params
    assert "robot0" not in header["parts"]
    assert header["robots"][1] == {"name": robot.name, "sha256": registry.policy(robot.name).sha256}
    assert header["asked"] == ["softer", "harder", "slower", "faster", "stop", "good"]


def test_a_robot_with_another_network_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"has a network of shape .* choose a robot with that shape"
    ):
        published(load_registry(), ["scratch/ppo-ego-s0-v1/robot"], network_of("gentle_scratch"))


def test_our_javascript_is_short() -> None:
    assets = resources.files("evaluation.seat") / "assets"
    assert sum((assets / name).read_text().count("\n") for name in OWN) < MOST_LINES


@needs("nodejs", NODE)
def test_hashes_of_logs_are_python_s(tmp_path: Path) -> None:
    record = (resources.files("evaluation.seat") / "assets" / "record.js").read_text()
    value = {"b": [1, 2.5, -0.0001, None, True], "a": {"ü": 'é"\\', "": ""}, "long": "x" * 300}
    script = f"{record}\nconsole.log(sha256(canonical({json.dumps(value)})));"
    done = subprocess.run([str(NODE), "-e", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == json_sha256(value)


@needs("nodejs", NODE)
def test_actions_are_written_as_bytes(tmp_path: Path) -> None:
    record = (resources.files("evaluation.seat") / "assets" / "record.js").read_text()
    script = f"{record}\nconsole.log(base64Of(new Float32Array([1, -0.5, 3e5])));"
    done = subprocess.run([str(NODE), "-e", script], capture_output=True, text=True, check=True)
    assert base64.b64decode(done.stdout) == b"\0\0\x80?\0\0\0\xbf\0\x7c\x92H"


@needs("nodejs", NODE)
def test_a_study_plays_each_robot_once_in_a_block() -> None:
    study = (resources.files("evaluation.seat") / "assets" / "study.js").read_text()
    script = f"""{study}
      const study = new Study(["a", "b", "c"].map((name) => ({{ name }})));
      const played = [], letters = {{}}, blocks = [];
      for (let k = 0; k < 300; ++k) {{
        const {{ block, order }} = study.about();
        played.push([block, order.join(""), study.robots[study.robot].name]);
        (letters[study.letter] ??= new Set()).add(study.robot);
        blocks.push(study.played());
      }}
      const robots = Object.values(letters).map((one) => one.size);
      console.log(JSON.stringify({{ played, robots, ends: blocks.filter(Boolean).length }}));"""
    done = subprocess.run([str(NODE), "-e", script], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["robots"] == [1, 1, 1] and found["ends"] == 100
    orders = set()
    for k in range(0, 300, 3):
        rows = found["played"][k : k + 3]
        assert {(block, order) for block, order, _ in rows} == {(k // 3 + 1, rows[0][1])}
        assert "".join(name for _, _, name in rows) == rows[0][1]
        orders.add(rows[0][1])
    assert len(orders) == 6
