import json
import queue
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from benchmarks import __main__ as bench
from benchmarks.__main__ import run
from benchmarks.storm import answer_of, probe, put_answer, stand_about


@pytest.mark.slow
def test_env_prints_speed_by_batch_size(capfd: pytest.CaptureFixture[str]):
    words = ["--task", "scratch", "--backend", "native", "--batch", "1,3", "--seconds", "0.03"]
    assert run(["env", *words, "--json"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [(row["task"], row["backend"], row["batch"]) for row in rows] == [
        ("scratch", "native", 1),
        ("scratch", "native", 3),
    ]
    for row in rows:
        assert min(row["repeats"]) <= row["env_steps_per_second"] <= max(row["repeats"])
        assert 10 <= row["steps"] <= 1000
        assert row["compile_seconds"] > 0


@pytest.mark.slow
def test_env_prints_a_line_for_people(capfd: pytest.CaptureFixture[str]):
    assert (
        run(
            [
                "env",
                "--task",
                "scratch",
                "--backend",
                "native",
                "--batch",
                "2",
                "--seconds",
                "0.03",
            ]
        )
        == 0
    )
    printed = capfd.readouterr().out
    assert "compilation not counted" in printed
    assert "env steps/s" in printed


@pytest.mark.slow
@pytest.mark.parametrize("task", ["scratch", "gentle_feeding"])
def test_env_with_persons_measures_both(task: str, capfd: pytest.CaptureFixture[str]):
    words = ["--task", task, "--backend", "native", "--batch", "16", "--seconds", "0.03"]
    assert run(["env", *words, "--persons", "--json"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [row["human"] for row in rows] == ["random", "persons"]
    assert all(row["env_steps_per_second"] > 0 for row in rows)


@pytest.mark.slow
def test_evaluate_compares_the_evaluator_with_the_environment(capfd: pytest.CaptureFixture[str]):
    bench.evaluate(task="scratch", backend="native", shape="1,2,2", seconds=0.03, json=True)
    (row,) = json.loads(capfd.readouterr().out)
    assert row["ratio"] > 0
    assert (row["egos"], row["partners"], row["episodes"]) == (1, 2, 2)
    assert row["pairs_per_second"] == pytest.approx(row["env_steps_per_second"] / 2000)


@pytest.mark.slow
def test_adapters_are_held_to_the_bare_environment(capfd: pytest.CaptureFixture[str]):
    words = ["--backend", "native", "--num-envs", "2", "--seconds", "0.03"]
    assert run(["adapters", *words, "--partners", "nobody,persons", "--json"]) == 0
    rows = json.loads(capfd.readouterr().out)
    assert [(row["partners"], row["num_envs"]) for row in rows] == [("nobody", 2), ("persons", 2)]
    for row in rows:
        assert min(row["repeats"]) <= row["env_steps_per_second"] <= max(row["repeats"])
        assert min(row["of_bare"], row["of_single"]) > 0 and len(row["load"]) == 2
    assert run(["adapters", "--partners", "split,friends"]) == 1
    assert "partners is 'friends'; allowed are split, persons, nobody" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--task", "feeding"], "task is 'feeding'; allowed are all, scratch"),
        (["--backend", "gpu"], "backend is 'gpu'; allowed are auto, fused, native"),
        (["--batch", "64,many"], "batch is '64,many'; expected whole numbers"),
        (["--batch", "0"], "expected whole numbers of at least 1"),
        (["--batch", ","], "give at least one value"),
        (["--seconds", "0"], "seconds is 0"),
    ],
)
def test_bad_input_gets_one_clear_line(
    words: list[str], message: str, capfd: pytest.CaptureFixture[str]
):
    assert run(["env", *words]) == 1
    lines = capfd.readouterr()
    assert message in lines.err
    assert lines.err.count("\n") == 1
    assert lines.out == ""


def test_a_shape_needs_three_numbers(capfd: Any):
    with pytest.raises(ValueError, match="three numbers"):
        bench.evaluate(shape="1,2")


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ippo", "isac"])
def test_train_tells_where_the_time_goes(algorithm: str, capfd: pytest.CaptureFixture[str]):
    words = [
        "--backend",
        "native",
        "--num-envs",
        "4",
        "--set",
        "rollout_steps=8",
        "--seconds",
        "0.1",
    ]
    extra = ["--set", "replay_size=64"] if algorithm == "isac" else []
    assert run(["train", "--algorithm", algorithm, *words, *extra, "--json"]) == 0
    row = json.loads(capfd.readouterr().out)
    assert row["env_steps_per_second"] > 0
    assert row["physics_share"] + row["networks_share"] + row["updates_share"] == pytest.approx(1.0)


@pytest.mark.slow
def test_fetch_measures_whole_commands(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("benchmarks.registry.REPEATS", 3)  # one may wait for the machine
    assert run(["fetch", "--policies", "8", "--json"]) == 0
    row = json.loads(capfd.readouterr().out)
    assert (row["policies"], row["shards"]) == (8, 8)
    assert (
        row["list_seconds"] > row["python_seconds"] > 0
        and row["list_terminal_seconds"] > row["python_seconds"]
    )
    assert row["verify_seconds"] > 0 and row["fetch_mb_per_second"] > 0
    assert run(["fetch", "--policies", "1"]) == 1
    assert "policies is 1; allowed is 2 to 20000" in capfd.readouterr().err


@pytest.mark.slow
def test_pages_reads_every_kind_of_page(tmp_path: Path):
    from tests.board.board_data import make_app
    from tests.board.running import serving

    # In a process of their own: the server's logs hold the output of this one, which `capfd`
    # closes.
    with serving(make_app(tmp_path)) as address:
        words = ["pages", "--url", address, "--readers", "30", "--seconds", "8", "--json"]
        command = [sys.executable, "-m", "benchmarks", *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    rows = {row["page"]: row for row in json.loads(done.stdout)}
    assert {"board", "submission", "explorer", "all"} <= rows.keys()
    assert rows["all"]["failed"] == 0
    assert rows["all"]["reads"] == sum(rows[kind]["reads"] for kind in rows if kind != "all")


def test_pages_of_no_server(capfd: pytest.CaptureFixture[str]):
    with socket.socket() as taken:  # bound and never listening
        taken.bind(("127.0.0.1", 0))
        assert run(["pages", "--url", f"http://127.0.0.1:{taken.getsockname()[1]}"]) == 1
    printed = capfd.readouterr().err
    assert "does not answer" in printed and printed.count("\n") == 1


def test_storm_ends_where_no_probe_is_answered():
    with socket.socket() as taken:  # bound and never listening
        taken.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{taken.getsockname()[1]}"
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        put_answer(answers, probe, (address, 0.0))  # the storm is over before it asks
    health = answer_of(answers)
    assert (health["asked"], health["failed"]) == (1, 1)


def test_a_crowd_stays_and_comes_again():
    """One connection asks and one sends half a request; the server hangs up on both."""
    heads: list[bytes] = []

    def serve(listener: socket.socket) -> None:
        lines = [listener.accept()[0] for _ in range(2)]
        heads.extend(line.recv(1000) for line in lines)
        for line, head in zip(lines, heads, strict=True):
            line.sendall(b"HTTP/1.1 200 OK\r\n\r\n" if head.endswith(b"\r\n\r\n") else b"")
            line.close()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = threading.Thread(target=serve, args=(listener,))
        server.start()
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        ended = stand_about(address, 2, time.time() + 1.0)
        server.join()
    assert ended["open at most"] == 2
    assert ended["answered 200"] == 1
    assert ended["not answered"] == 3, "half a request, and two that came again and were left"


def test_storm_hears_of_a_process_that_broke():
    answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
    put_answer(answers, probe, ("no address", 0.0))
    with pytest.raises(RuntimeError, match="probe broke: ValueError"):
        answer_of(answers)
