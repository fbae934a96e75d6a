"""A rehearsal: a whole tiny season on this machine, by what a real one is made by.

Hidden partners are trained from a private plan, a server with a worker runs as `serve` starts it,
two labs hand robots in over HTTP, the season closes at its date, and anybody's proof is made.
"""

import contextlib
import dataclasses
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from assistax_board.checking import check_ledger, check_service
from assistax_board.client import Client
from assistax_board.ids import new_id
from assistax_board.live.client import play_live
from assistax_board.rules.release_pack import add_persons
from assistax_board.rules.seasons import Plan
from assistax_board.serve import open_service
from assistax_board.service import Service
from assistax_board.store.backup import back_up
from assistax_board.submitting import verify_revealed
from assistax_board.vocabulary import BACKEND, FINAL_STATES
from assistax_envs.preferences import preferences_of

SEASON = "rehearsal"
LIMIT_SECONDS = 1800.0  # for any one thing to happen
TINY = {"num_envs": 4, "rollout_steps": 8, "minibatches": 2, "epochs": 1, "hidden": [8, 8]}
PERSONS = 4  # hidden, where the task has any
MEMBERS = {"disabilities": ("d1", "d9"), "seeds": 2, "steps": 32, "self_play_episodes": 1}


@dataclasses.dataclass(frozen=True)
class Stage:
    """Where a season is rehearsed."""

    folder: Path  # empty
    task: str
    registry: Path | None  # of the public partners; the installed one if None
    backend: str = BACKEND
    open_seconds: float = 120.0  # for which labs may hand in

    @property
    def data(self) -> Path:
        """Return the folder of the service."""
        return self.folder / "board"

    @property
    def private(self) -> Path:
        """Return the folder of the private release."""
        return self.folder / "private"


def rehearse(stage: Stage) -> Iterator[str]:
    """Rehearse a season, and yield a line about each thing that was done.

    Raises:
        ValueError: Something went otherwise than it should in a season.
    """
    from zoo.registry import load_registry

    count = train_hidden(stage)
    yield f"trained {count} hidden teams from a secret plan: {stage.private}"
    if preferences_of(stage.task):
        add_persons(stage.private, stage.task, PERSONS)
        yield f"drew {PERSONS} hidden persons from a secret, beside them"
    service = open_service(stage.data, registry=stage.registry, backend=stage.backend)
    plan = Plan(SEASON, stage.task, budget=3, small=True)
    season = service.create_season(plan, stage.private, load_registry(stage.registry))
    with running_server(stage) as address, contextlib.ExitStack() as stack:

        def client(token: str | None = None) -> Client:
            made = Client(address, token, patience=LIMIT_SECONDS)
            return stack.enter_context(contextlib.closing(made))

        yield f"a server with a worker answers at {address}"
        closes_at = service.clock() + stage.open_seconds
        root = service.open_season(SEASON, closes_at)
        yield f"season {SEASON} is open for {stage.open_seconds:.0f} s; its root is {root}"
        yield from hand_in(stage, service, client)
        visitor = client()
        wait("the season closes at its date", lambda: state_of(visitor) in ("closing", "closed"))
        if service.clock() < closes_at:
            raise ValueError("the season closed before its date")
        yield "the closing date came: nothing more is taken, panel B is played"
        wait("everything is revealed", lambda: state_of(visitor) == "closed")
        yield from check(stage, service, visitor, season, root)
    yield "the server has stopped, and its workers with it"


def train_hidden(stage: Stage) -> int:
    """Train and publish the teams of a private plan; return how many there are."""
    from assistax_workshop.plans.plan import Group, private_plan, write_private_plan
    from assistax_workshop.plans.plan import Plan as TrainingPlan
    from assistax_workshop.plans.training import PlanTraining

    fields: dict[str, Any] = {**MEMBERS, "set": TINY}
    group = Group(name="rehearsal", task=stage.task, algorithm="ippo", **fields)
    plan = private_plan(TrainingPlan(version=1, release="v0", groups=(group,)))
    path = stage.private / "plan.json"
    write_private_plan(plan, path)
    training = PlanTraining(
        plan=plan,
        groups=list(plan.groups),
        path=path,
        out=stage.private / "runs",
        registry=stage.private / "registry.json",
        backend=stage.backend,
        shown=lambda _: contextlib.nullcontext(lambda _: None),
    )
    training.do(train=True, publish=True, curves=None)
    if training.errors:
        raise ValueError("; ".join(training.errors.values()))
    return sum(len(group.members) for group in plan.groups)


@contextlib.contextmanager
def running_server(stage: Stage) -> Generator[str]:
    """Run `assistax-zoo serve` with one worker, and yield its address; its log is a file."""
    words = ["serve", "--data", str(stage.data), "--port", "0", "--backend", stage.backend]
    words += ["--no-references", *(["--registry", str(stage.registry)] if stage.registry else [])]
    log = stage.folder / "server.log"
    with log.open("w") as file:
        process = subprocess.Popen([sys.executable, "-m", "assistax_zoo", *words], stderr=file)
    try:
        wait("the server starts", lambda: "serving " in log.read_text() or _ended(process, log))
        address = log.read_text().split("serving ")[1].split()[0]
        with contextlib.closing(Client(address, patience=LIMIT_SECONDS)) as client:
            client.about()
        yield address
    finally:
        process.send_signal(signal.SIGTERM)
        code = process.wait(LIMIT_SECONDS)
    if code:
        raise ValueError(f"the server ended with exit code {code}; see {log}")


def hand_in(stage: Stage, service: Service, new_client: Callable[[str], Client]) -> Iterator[str]:
    """Let two labs hand in: each a file to the season, and one of them a live robot too."""
    from zoo.exports.policies import export_policy
    from zoo.registry import load_registry

    registry = load_registry(stage.registry)
    robots = registry.of_task(stage.task, "robot")
    submitted: list[tuple[Client, str]] = []
    for lab, robot, format in (
        ("Lab of Ada", robots[0], "safetensors"),
        ("Lab of Grace", robots[-1], "onnx"),
    ):
        path = stage.folder / f"robot.{format}"
        export_policy(robot.id, format, path, lambda: registry)
        token = service.create_token(("submit",), submitter=lab)
        client = new_client(token)
        fields = {"task": stage.task, "method": robot.team.partition("/")[2], "season": SEASON}
        id = client.submit(path.read_bytes(), request_id=new_id(20), **fields)["id"]
        client.enter(SEASON, [id])
        submitted.append((client, id))
        yield f"{lab} handed in {path.name} as {id}, and entered it for panel B"
    live = client.submit(b"", request_id=new_id(20), kind="live", task=stage.task, method="still")
    submitted.append((client, live["id"]))
    actions = robots[0].spec.action_size

    def still(obs: np.ndarray) -> np.ndarray:
        return np.zeros((len(obs), actions), np.float32)

    playing = threading.Thread(target=play_live, args=(client, live["id"], still), daemon=True)
    playing.start()
    yield f"{lab} connected a live robot as {live['id']}: it meets public partners alone"
    for client, id in submitted:
        wait(f"{id} ends", lambda c=client, i=id: c.submission(i)["state"] in FINAL_STATES)
        submission = client.submission(id)
        if submission["state"] != "scored":
            raise ValueError(
                f"submission {id} is {submission['state']}: {submission['reason_text']}"
            )
        shown = {score["panel"]: score["figures"]["mean"] for score in client.scores(id)}
        means = ", ".join(f"{panel} {mean:.1f}" for panel, mean in sorted(shown.items()))
        yield f"{id} is scored ({means}); its receipt is signed: {bool(client.receipt(id))}"
    playing.join(LIMIT_SECONDS)


def check(stage: Stage, service: Service, visitor: Client, season: str, root: str) -> Iterator[str]:
    """Check what a closed season owes everybody, and what its organiser keeps."""
    proof = verify_revealed(visitor, SEASON, root)
    yield f"proved: the {proof['partners']} partners that are revealed are those it opened with"
    played = [score for score in service.queries.scores(season=season) if score.panel == "B"]
    if len(played) != 2:
        raise ValueError(f"panel B has {len(played)} scores; each of two labs entered one")
    for score in sorted(played, key=lambda score: -score.figures["mean"]):
        yield f"panel B: {score.method} of {score.submitter} earned {score.figures['mean']:.1f}"
    page = visitor.call("GET", f"/seasons/{season}").text
    if not all(score.method in page for score in played):
        raise ValueError("the season's page lacks an entry")
    yield f"the season's page shows them: {visitor.address}/seasons/{season}"
    ledger, kept = check_ledger(visitor), check_service(service)
    yield f"the ledger's {ledger['entries']} entries are a chain"
    yield f"{kept['artefacts']} artefacts and {kept['receipts']} receipts are whole"
    count = back_up(stage.data, stage.folder / "board.zip")
    yield f"a backup has the database, the key and {count} artefacts"


def state_of(client: Client) -> str:
    """Return the state of the season that is rehearsed."""
    return client.call("GET", f"/api/seasons/{SEASON}").json()["state"]


def wait(what: str, is_so: Callable[[], Any]) -> None:
    """Wait until something is so.

    Raises:
        ValueError: It is not so for half an hour.
    """
    end = time.monotonic() + LIMIT_SECONDS
    while not is_so():
        if time.monotonic() > end:
            raise ValueError(f"waited {LIMIT_SECONDS / 60:.0f} minutes in vain: {what}")
        time.sleep(0.5)


def _ended(process: subprocess.Popen[bytes], log: Path) -> bool:
    if process.poll() is not None:
        raise ValueError(f"the server ended: {log.read_text()[-500:]}")
    return False
