"""A stranger's file gets so many seconds and bytes, and takes them from nobody else."""

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import httpx2
import jax
import numpy as np
import pytest
from onnx import helper

from assistax_board.api import desk
from assistax_board.client import Client
from assistax_board.problems import Problem, Refusal
from assistax_board.robots import admission, limited
from assistax_board.robots.admission import Admission
from assistax_board.robots.limited import BusyError, DiedError, OverBudgetError, run_limited
from assistax_board.rules.submissions import Admitted
from assistax_board.service import Service
from population.networks.onnx_export import to_onnx
from population.networks.spec import PolicySpec
from tests.board.fakes import TASK, shown
from tests.board.onnx_files import ACT, OBS, made, value
from tests.board.running import served, soon
from tests.untrained import params_of

SIZES = {TASK: (OBS, ACT)}
MIB = 1024 * 1024


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A function has time to use its seconds, though others use the machine and come before it."""
    monkeypatch.setattr(limited, "STALL", 600.0)


def answer(pid: Any = None) -> int:
    return os.getpid()


def spin() -> None:
    while True:
        pass


def fill() -> None:
    kept = []
    while True:
        kept.append(bytearray(os.urandom(MIB)))


def abort() -> None:
    os.abort()


def ended_by(number: int) -> None:
    os.kill(os.getpid(), number)
    time.sleep(60)


def play(function: Any, *args: Any, seconds: int = 20, most: int = 1024 * MIB) -> Any:
    return run_limited(function, *args, seconds=seconds, most_bytes=most)


@pytest.mark.slow
def test_limited_function_runs_and_ends_apart() -> None:
    pid = play(answer)
    assert pid != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(DiedError):
        play(abort)
    with pytest.raises(BusyError):
        play(ended_by, signal.SIGTERM)


def niceness() -> list[int]:
    return [os.getpriority(os.PRIO_PROCESS, process) for process in (os.getpid(), os.getppid())]


def test_what_looks_at_files_comes_after_requests() -> None:
    least = min(10, 19 - os.nice(0))  # more than 19 there is not
    assert min(play(niceness)) - os.nice(0) >= least


@pytest.mark.slow
def test_seconds_and_bytes_are_bounded() -> None:
    with pytest.raises(OverBudgetError, match="seconds"):
        play(spin, seconds=1)
    with pytest.raises(OverBudgetError, match="bytes"):
        play(fill, most=512 * MIB)


def file_of(nodes: list[Any], constants: dict[str, np.ndarray], last: str) -> bytes:
    """Return an ONNX robot of scratch with these nodes."""
    ends = {"inputs": [value("obs", ["N", OBS])], "outputs": [value(last, ["N", ACT])]}
    return made(nodes, constants, **ends).SerializeToString()


def many_shapes(count: int) -> bytes:
    """Every node makes another shape: a second of a compiler each, if each is compiled alone."""
    constants = {"w": np.full((OBS, ACT), 0.01, np.float32)}
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["action"])]
    for place in range(count):
        constants[f"c{place}"] = np.ones((1, 2 + place), np.float32)
        nodes.append(helper.make_node("Tanh", [f"c{place}"], [f"t{place}"]))
        nodes.append(helper.make_node("Softmax", [f"t{place}"], [f"s{place}"]))
    return file_of(nodes, constants, "action")


@pytest.mark.slow
def test_unlike_operators_are_compiled_at_once() -> None:
    Admission(SIZES).read(many_shapes(1), TASK)
    data, began = many_shapes(150), time.process_time()
    Admission(SIZES).read(data, TASK)
    assert time.process_time() - began < 5.0


def test_a_long_chain_of_operators_is_compiled_fast_not_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A compiler that does its best took nine seconds for a chain of 1,990 operators."""
    names = [*(f"v{place}" for place in range(200)), "action"]
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["v0"])]
    nodes += [helper.make_node("Tanh", [old], [new]) for old, new in pairwise(names)]
    data = file_of(nodes, {"w": np.full((OBS, ACT), 0.01, np.float32)}, "action")
    given, compiled = [], jax.stages.Lowered.compile

    def recorded(lowered: Any, compiler_options: Any = None) -> Any:
        given.append(compiler_options)
        return compiled(lowered, compiler_options)

    monkeypatch.setattr(jax.stages.Lowered, "compile", recorded)
    assert Admission(SIZES).read(data, TASK).format == "onnx"
    [options] = given
    assert options["xla_backend_optimization_level"] == "0"


def test_admission_names_the_exceeded_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = PolicySpec("robot", OBS, ACT, hidden=(8,))
    good = to_onnx(spec, params_of(spec, 0))
    assert Admission(SIZES)(good, TASK).format == "onnx"
    with monkeypatch.context() as patch, pytest.raises(Refusal) as refusal:
        patch.setattr(admission, "BYTES", MIB)
        Admission(SIZES)(good, TASK)
    assert refusal.value.code == "graph_too_large"

    def busy(*_: Any, **__: Any) -> None:
        raise BusyError

    with monkeypatch.context() as patch, pytest.raises(Problem, match="busy"):
        patch.setattr(admission, "run_limited", busy)
        Admission(SIZES)(good, TASK)
    monkeypatch.setattr(admission, "run_limited", lambda *_, **__: play(spin, seconds=1))
    with pytest.raises(Refusal) as refusal:
        Admission(SIZES)(good, TASK)
    assert refusal.value.code == "too_slow"


@pytest.mark.slow
def test_pages_do_not_wait_for_admission(service: Service) -> None:
    """Forty threads answer all requests; a file that takes long must keep none of them."""
    go_on = waits(service)
    with served(service) as server, ThreadPoolExecutor(48) as pool:
        labs = [server.client("submit", f"lab {number}") for number in range(48)]
        answers = [pool.submit(hand_in, lab) for lab in labs]
        time.sleep(2.0)
        # Files are looked at for longer than a reader waits.
        assert httpx2.get(f"{server.address}/api/health", timeout=20.0).status_code == 200
        assert not any(row.done() for row in answers)
        go_on.set()
        ids = [row.result() for row in answers]
    assert {shown(service, id).state for id in ids} == {"queued"}


def hand_in(client: Client) -> str:
    fields = {"task": TASK, "method": "m", "request_id": "request-1"}
    return client.submit(b"robot 1.0", **fields)["id"]


def waits(service: Service) -> threading.Event:
    """Let whoever looks at a file wait for the event."""
    go_on = threading.Event()
    object.__setattr__(service, "admit", lambda data, task: Admitted(str(go_on.wait(60))))
    return go_on


@pytest.fixture
def come(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Of each file that has its place at the desk, what looks at it."""
    seen, run = [], desk.Desk.run

    def counted(self: desk.Desk, *args: Any, **options: Any) -> Any:
        seen.append(args[0])
        return run(self, *args, **options)

    monkeypatch.setattr(desk.Desk, "run", counted)
    return seen


def test_one_lab_keeps_few_places_at_the_desk(service: Service, come: list[Any]) -> None:
    go_on = waits(service)
    with served(service) as server, ThreadPoolExecutor(4) as pool:
        many, other = server.client("submit", "many"), server.client("submit", "other")
        fields = {"task": TASK, "method": "m"}
        answers = [
            pool.submit(many.submit, b"robot 1.0", request_id=f"request-{i}", **fields)
            for i in range(4)
        ]
        assert soon(lambda: len(come) == 4)
        # Patience ends while they wait: the argument is for the start alone.
        many._patience = other._patience = 0.0
        with pytest.raises(OSError, match="503"):
            many.submit(b"robot 1.0", request_id="request-9", **fields)
        threading.Timer(0.5, go_on.set).start()
        assert hand_in(other)
        assert len({row.result()["id"] for row in answers}) == 4


def test_a_long_look_is_answered_and_goes_on(
    service: Service, come: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client hears in time that it may ask again, and then gets the first look's answer."""
    monkeypatch.setattr(desk, "ANSWER_SECONDS", 0.05)
    go_on, looks = threading.Event(), []

    def admit(data: bytes, task: str) -> Admitted:
        looks.append(task)
        return Admitted(str(go_on.wait(60)))

    object.__setattr__(service, "admit", admit)
    with served(service) as server, ThreadPoolExecutor(1) as pool:
        impatient, patient = server.client("submit", patience=0.0), server.client("submit")
        with pytest.raises(OSError, match="503"):
            hand_in(impatient)
        answer = pool.submit(hand_in, patient)
        assert soon(lambda: len(come) >= 4)
        go_on.set()
        assert shown(service, answer.result()).state == "queued"
    assert looks == [TASK]


@pytest.mark.slow
def test_a_full_desk_refuses_one_more_file(service: Service, come: list[Any]) -> None:
    go_on = waits(service)
    with served(service) as server, ThreadPoolExecutor(desk.WAITING) as pool:
        labs = [server.client("submit", f"lab {number}") for number in range(desk.WAITING)]
        answers = [pool.submit(hand_in, lab) for lab in labs]
        late = server.client("submit", "late")
        assert soon(lambda: len(come) == desk.WAITING)
        # Patience ends while they wait: the argument is for the start alone.
        late._patience = 0.0
        with pytest.raises(OSError, match="503"):
            hand_in(late)
        assert not go_on.is_set()
        go_on.set()
        assert len({row.result() for row in answers}) == desk.WAITING
