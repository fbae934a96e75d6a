"""A server under attack by files, slow bodies, readers and a crowd; counts lost submitters.

The server is the real one, in a process of its own, with a worker beside it that brings made-up
returns. Labs that hand in as they should are there all the while.
"""

import asyncio
import contextlib
import dataclasses
import http.client
import itertools
import os
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from assistax_board.client import Client
from benchmarks.pages import PageSpeed, read_pages
from benchmarks.service import ROBOT, SPAWN, TASK, Peak, memory_of, serving, work_made_up

LABS = 20  # attacking labs, each with its own token
HONEST = 5  # honest labs
CALM_SECONDS = 10.0  # before memory is first measured
WIDE = 65_536
ELSEWHERE_NICE = 5  # niceness of clients and workers, which elsewhere run on other machines
ELSEWHERE = "127.0.0.2"  # address of slow bodies, since rates are by address
CROWD = "127.0.0.3"  # address of the crowd


@dataclasses.dataclass(frozen=True)
class Storm:
    """Figures of a server in a storm."""

    seconds: float
    health: dict[str, float]  # milliseconds: median, p99, most; and how many failed of how many
    pages: PageSpeed
    files: dict[str, int]  # how hostile files ended
    bodies: dict[str, int]  # how slow bodies ended
    crowd: dict[str, int]  # connections that were open at once, and how all of them ended
    honest: dict[str, int]  # final states of honest labs' submissions
    memory: tuple[float, float, float]  # MB of the server and its children: before, most, after
    calm_after: float  # seconds until memory was within a fifth of what it had been
    load: tuple[float, float]


def measure_storm(
    files: int, bodies: int, readers: int, crowd: int, seconds: float, database: str | None = None
) -> Storm:
    """Return the figures of a new server that all attacks strike for a while."""
    from assistax_board.serve import open_service
    from assistax_board.submitting import read_file

    before, robot = os.getloadavg()[0], read_file(Path(ROBOT))
    with tempfile.TemporaryDirectory(prefix="assistax-zoo-") as folder:
        with serving(Path(folder), database) as (process, address):
            os.nice(ELSEWHERE_NICE)
            service = open_service(Path(folder))
            tokens = {
                name: service.create_token(("submit",), submitter=name)
                for name in [*names("hostile", LABS), *names("honest", HONEST)]
            }
            worker = (address, service.create_token(("work",), label="made up"))
            hand_in(address, tokens["honest 0"], robot, "first")
            bad = [tokens[lab] for lab in names("hostile", LABS)]
            with _alongside(work_made_up, *worker) as _:
                read_pages(address, 20, CALM_SECONDS)
                calm, tree = memory_of(process.pid), Peak(process.pid)
                end = time.time() + seconds
                with contextlib.ExitStack() as stack:
                    answers = [
                        stack.enter_context(_alongside(attack, *args))
                        for attack, *args in (
                            (hand_in_hostile, address, bad, files, end),
                            (send_slowly, address, bad, bodies, end),
                            (stand_about, address, crowd, end),
                            (be_honest, address, [tokens[n] for n in names("honest", HONEST)], end),
                            (probe, address, end),
                        )
                    ]
                    pages = read_pages(address, readers, seconds)[-1]
                    ended = [answer_of(answer) for answer in answers]
                calm_after = tree.wait_for(1.2 * calm)
        states = Counter(
            submission.state
            for submission in service.queries.submissions(limit=100_000)
            if submission.submitter.startswith("honest")
        )
        service.database.close()
    refused, slow, stood, handed_in, health = ended
    lost = {"handed in": handed_in["handed in"] + 1, **states}
    memory = (calm / 1e6, tree.most / 1e6, tree.last / 1e6)
    load = (before, os.getloadavg()[0])
    return Storm(seconds, health, pages, refused, slow, stood, lost, memory, calm_after, load)


def names(kind: str, count: int) -> list[str]:
    """Return the names of `count` labs of a kind."""
    return [f"{kind} {number}" for number in range(count)]


@contextlib.contextmanager
def _alongside(function: Callable[..., Any], *args: Any) -> Any:
    """Run a function in its own process; yield the queue of its answer."""
    answers: Any = SPAWN.Queue()
    process = SPAWN.Process(target=put_answer, args=(answers, function, args), daemon=True)
    process.start()
    try:
        yield answers
    finally:
        process.terminate()
        process.join()


def put_answer(answers: Any, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
    """Put a function's result into a queue, or its error: the queue's reader waits for one."""
    try:
        answers.put(function(*args))
    except Exception as error:
        name = getattr(function, "__name__", "a process")
        answers.put(RuntimeError(f"{name} broke: {type(error).__name__}: {error}"))


def answer_of(answers: Any) -> Any:
    """Return the result that a process puts into its queue.

    Raises:
        RuntimeError: The process's own error.
    """
    answer = answers.get(timeout=900)
    if isinstance(answer, Exception):
        raise answer
    return answer


def hand_in_hostile(address: str, tokens: list[str], count: int, end: float) -> dict[str, int]:
    """Submit files that would take hours or gigabytes, all at once; return counts of outcomes."""
    ended: Counter[str] = Counter()

    def hand(number: int) -> None:
        client = Client(address, tokens[number % len(tokens)], patience=600.0)
        try:
            fields = {"task": TASK, "method": f"file {number}"}
            data = hostile_file(number)
            id = client.submit(data, request_id=f"hostile-{number}", **fields)["id"]
            submission = client.submission(id)
            ended[str(submission["reason"] or submission["state"])] += 1
        except ValueError as error:
            ended[str(error)[:60]] += 1
        finally:
            client.close()

    _all_at_once(hand, count)
    return dict(ended)


def hostile_file(number: int) -> bytes:
    """Return an ONNX robot of scratch: wide and long, or of many shapes, or random bytes in one."""
    from onnx import TensorProto, helper, numpy_helper

    constants = {"w": np.full((34, 7), 0.01, np.float32)}
    nodes = [helper.make_node("MatMul", ["obs", "w"], ["action"])]
    if number % 3 == 0:  # hours
        constants = {"w": np.ones((34, 1), np.float32), "o": np.ones((1, WIDE), np.float32)}
        constants |= {"s": np.array([0]), "e": np.array([7]), "a": np.array([1])}
        chain = ["wide", *(f"t{place}" for place in range(280))]
        nodes = [helper.make_node("MatMul", ["obs", "w"], ["x"])]
        nodes.append(helper.make_node("Mul", ["x", "o"], ["wide"]))
        nodes += [helper.make_node("Tanh", [a], [b]) for a, b in itertools.pairwise(chain)]
        nodes.append(helper.make_node("Slice", [chain[-1], "s", "e", "a"], ["action"]))
    elif number % 3 == 1:  # a compiler's minutes
        for place in range(150 + number):
            constants[f"c{place}"] = np.ones((1, 2 + place), np.float32)
            nodes.append(helper.make_node("Tanh", [f"c{place}"], [f"t{place}"]))
            nodes.append(helper.make_node("Softmax", [f"t{place}"], [f"s{place}"]))
    tensors = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    obs = helper.make_tensor_value_info("obs", TensorProto.FLOAT, ["N", 34])
    action = helper.make_tensor_value_info("action", TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "g", [obs], [action], tensors)
    opsets = [helper.make_opsetid("", 17)]
    data = helper.make_model(graph, opset_imports=opsets, ir_version=8).SerializeToString()
    if number % 3 == 2:
        rng, damaged = np.random.default_rng(number), bytearray(data)
        for place in rng.integers(len(data), size=8):
            damaged[place] = rng.integers(256)
        data = bytes(damaged)
    return data


def send_slowly(address: str, tokens: list[str], count: int, end: float) -> dict[str, int]:
    """Send bodies of a megabyte at a byte a second; return counts of outcomes."""
    ended: Counter[str] = Counter()
    host, port = address.rpartition("/")[2].split(":")
    to = host, int(port)

    def send(number: int) -> None:
        token = tokens[number % len(tokens)]
        query = f"task={TASK}&method=slow&request_id=slow-request-{number}"
        head = f"POST /api/submissions?{query} HTTP/1.1\r\nHost: {host}\r\n"
        head += f"Authorization: Bearer {token}\r\nContent-Length: 1000000\r\n\r\n"
        while time.time() < end:
            source: dict[str, Any] = {"timeout": 10.0, "source_address": (ELSEWHERE, 0)}
            with contextlib.suppress(OSError), socket.create_connection(to, **source) as line:
                line.sendall(head.encode())
                line.settimeout(1.0)
                ended[_drip(line, end)] += 1
            time.sleep(1.0)

    _all_at_once(send, count)
    return dict(ended)


def _drip(line: socket.socket, end: float) -> str:
    """Send a byte a second until an answer or the end; return the outcome."""
    while time.time() < end:
        line.sendall(b"x")
        with contextlib.suppress(TimeoutError):
            answer = line.recv(100).split()
            return f"answered {answer[1].decode()}" if len(answer) > 1 else "hung up on"
    return "still sending"


def stand_about(address: str, count: int, end: float) -> dict[str, int]:
    """Keep connections open that say nothing more, and return counts of outcomes.

    Half of them have asked for the health check, the others have sent half a request. Each is made
    anew when the server hangs up.
    """
    ended: Counter[str] = Counter()
    host, port = address.rpartition("/")[2].split(":")
    head = f"GET /api/health HTTP/1.1\r\nHost: {host}\r\n".encode()

    async def stand(number: int) -> None:
        while time.time() < end:
            try:
                reader, writer = await asyncio.open_connection(host, port, local_addr=(CROWD, 0))
            except OSError:
                ended["not taken in"] += 1
                await asyncio.sleep(1.0)
                continue
            ended["open now"] += 1
            ended["open at most"] = max(ended["open at most"], ended["open now"])
            writer.write(head + b"\r\n" * (number % 2))
            answer = b""
            with contextlib.suppress(OSError, TimeoutError):  # until the server hangs up
                answer = await asyncio.wait_for(reader.read(), max(0.0, end - time.time()))
            ended[f"answered {answer.split()[1].decode()}" if answer else "not answered"] += 1
            ended["open now"] -= 1
            writer.close()

    async def stand_all() -> None:
        await asyncio.gather(*(stand(number) for number in range(count)))

    asyncio.run(stand_all())
    del ended["open now"]
    return dict(ended)


def be_honest(address: str, tokens: list[str], end: float) -> dict[str, int]:
    """Submit robots one after another and wait for each; return counts of final states."""
    from assistax_board.submitting import read_file

    robot, ended = read_file(Path(ROBOT)), Counter[str]()

    def lab(number: int) -> None:
        count = 0
        while count == 0 or time.time() < end:
            ended["handed in"] += 1
            ended[hand_in(address, tokens[number], robot, f"robot {count}")] += 1
            count += 1
            time.sleep(5.0)

    _all_at_once(lab, len(tokens))
    return dict(ended)


def hand_in(address: str, token: str, data: bytes, name: str) -> str:
    """Submit a robot and return its final state; a worker may come later."""
    client = Client(address, token, patience=600.0)
    id = client.submit(data, request_id=f"honest-{name}", task=TASK, method=name)["id"]
    state = client.submission(id)["state"]
    while name != "first" and state not in ("scored", "refused", "failed", "retracted"):
        time.sleep(2.0)
        state = client.submission(id)["state"]
    client.close()
    return state


def probe(address: str, end: float) -> dict[str, float]:
    """Return latencies (ms) and failures of the health check, ten a second on new connections.

    It uses plain connections: a client of `httpx2` takes longer to make than the answer to come.
    It asks at least once. A check that fails counts with the time until its end.
    """
    times: list[float] = []
    failed = 0
    host, port = address.rpartition("/")[2].split(":")
    while not times or time.time() < end:
        began, line = time.monotonic(), http.client.HTTPConnection(host, int(port), timeout=10.0)
        try:
            line.request("GET", "/api/health")
            failed += line.getresponse().status != 200
        except OSError:
            failed += 1
        finally:
            line.close()
        times.append(1000 * (time.monotonic() - began))
        time.sleep(0.1)
    median, p99 = np.quantile(times, [0.5, 0.99])
    most = max(times)
    return {"median": median, "p99": p99, "most": most, "failed": failed, "asked": len(times)}


def _all_at_once(function: Callable[[int], None], count: int) -> None:
    """Call a function for each number in its own thread, and wait for all."""
    threads = [threading.Thread(target=function, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
