"""A rehearsal: a whole tiny season on this machine, made with the real commands and server.

Hidden partners are trained from a private plan, a server with a worker runs as `serve` starts it,
two labs hand robots in over HTTP, the season closes at its date, and anybody's proof is made. The
server is upgraded while the season is open, and killed while it closes.
"""

import contextlib
import dataclasses
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

from assistax_board.checking import check_ledger, check_service
from assistax_board.client import Client
from assistax_board.ids import new_id
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
SILENT_SECONDS = 60.0  # between two lines about a submission that is played
TINY = {"num_envs": 4, "rollout_steps": 8, "minibatches": 2, "epochs": 1, "hidden": [8, 8]}
HIDDEN_PERSONS = 4  # hidden, where the task has any
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
    def older(self) -> str:
        """Return the engine of the version before: another one makes another version of scores."""
        return "fused" if self.backend != "fused" else "native"

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

    yield "stage 1 of 6, train hidden teams"
    yield f"trained {train_hidden(stage)} hidden teams from a secret plan: {stage.private}"
    if preferences_of(stage.task):
        add_persons(stage.private, stage.task, HIDDEN_PERSONS)
        yield f"drew {HIDDEN_PERSONS} hidden persons from a secret, beside them"
    service = open_service(stage.data, registry=stage.registry, backend=stage.backend)
    plan = Plan(SEASON, stage.task, budget=3, small=True)
    season = service.create_season(plan, stage.private, load_registry(stage.registry))
    with running_server(stage) as server, contextlib.ExitStack() as stack:

        def client(token: str | None = None) -> Client:
            made = Client(server.address, token, patience=LIMIT_SECONDS)
            return stack.enter_context(contextlib.closing(made))

        yield f"a server with a worker answers at {server.address}, on {stage.older}"
        yield "stage 2 of 6, open a season and hand robots in"
        root = service.open_season(SEASON, service.clock() + stage.open_seconds)
        yield f"season {SEASON} is open for {stage.open_seconds:.0f} s; its root is {root}"
        submitted: list[tuple[Client, str]] = []
        for line, lab, id in hand_in(stage, service, client):
            submitted.append((lab, id))
            yield line
        yield "stage 3 of 6, upgrade the server"
        yield from upgrade(stage, service, server, *submitted[0])
        yield "stage 4 of 6, wait for the closing date"
        visitor, closes_at = client(), closing_date(service)
        wait("the season closes at its date", lambda: state_of(visitor) in ("closing", "closed"))
        if service.clock() < closes_at:
            raise ValueError("the season closed before its date")
        yield "the closing date came: nothing more is taken, panel B is played"
        yield "stage 5 of 6, kill the server while it closes, and play panel B"
        yield from kill(stage, service, server)
        yield from scores_of(submitted)
        wait("everything is revealed", lambda: state_of(visitor) == "closed")
        yield "stage 6 of 6, reveal, prove, check, back up"
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


class Server:
    """`assistax-zoo serve` with one worker, at one address however often it starts; its log."""

    def __init__(self, stage: Stage) -> None:
        self._stage, self._log = stage, stage.folder / "server.log"
        self.address = "http://127.0.0.1:0"  # a free port, until it has started once

    def start(self, backend: str) -> None:
        """Start it on an engine, and wait until it answers.

        Raises:
            ValueError: It ended instead.
        """
        registry = self._stage.registry
        began = self._log.stat().st_size if self._log.exists() else 0
        port = self.address.rpartition(":")[2]
        words = ["serve", "--data", str(self._stage.data), "--port", port]
        words += ["--backend", backend, "--no-references"]
        words += ["--registry", str(registry)] if registry else []
        with self._log.open("a") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "assistax_zoo", *words], stderr=file
            )

        def serves() -> bool:
            output = self._log.read_text()[began:]
            if self.process.poll() is not None:
                raise ValueError(f"the server ended: {output[-1000:].strip()}")
            if found := re.search(r"serving (\S+) from ", output):
                self.address = found[1]
            return found is not None

        wait("the server starts", serves)
        with contextlib.closing(Client(self.address, patience=LIMIT_SECONDS)) as client:
            client.about()

    def stop(self) -> None:
        """Stop it as Ctrl-C does.

        Raises:
            ValueError: It ends with an error.
        """
        self.process.send_signal(signal.SIGTERM)
        if code := self.process.wait(LIMIT_SECONDS):
            raise ValueError(f"the server ended with exit code {code}; see {self._log}")


@contextlib.contextmanager
def running_server(stage: Stage) -> Generator[Server]:
    """Run a server of the version before; at the end, stop the server that then runs."""
    server = Server(stage)
    server.start(stage.older)
    try:
        yield server
    except BaseException:
        server.process.kill()
        server.process.wait()
        raise
    server.stop()


def hand_in(
    stage: Stage, service: Service, new_client: Callable[[str], Client]
) -> Iterator[tuple[str, Client, str]]:
    """Let two labs hand in a file each; yield a line about it, the lab's client and the id."""
    from zoo.exports.policies import policy_file
    from zoo.registry import load_registry

    registry = load_registry(stage.registry)
    robots = registry.of_task(stage.task, "robot")
    for lab, robot, format in (
        ("Lab of Ada", robots[0], "safetensors"),
        ("Lab of Grace", robots[-1], "onnx"),
    ):
        data = policy_file(robot.id, format, lambda: registry)
        client = new_client(service.create_token(("submit",), submitter=lab))
        keep_open(stage, service)
        fields = {"task": stage.task, "method": robot.team.partition("/")[2], "season": SEASON}
        id = client.submit(data, request_id=new_id(20), **fields)["id"]
        keep_open(stage, service)
        client.enter(SEASON, [id])
        yield f"{lab} handed in robot.{format} as {id}, and entered it for panel B", client, id


def upgrade(
    stage: Stage, service: Service, server: Server, client: Client, id: str
) -> Iterator[str]:
    """Start the server in the newest version once one robot was scored by the version before."""
    yield from watch(client, id, lambda: keep_open(stage, service))
    server.stop()
    server.start(stage.backend)
    yield f"upgraded while the season is open: {stage.backend} plays anew what {stage.older} scored"


def scores_of(submitted: Sequence[tuple[Client, str]]) -> Iterator[str]:
    """Wait for the scores of submissions, each given with its lab's client."""
    for client, id in submitted:
        yield from watch(client, id)
        submission = client.submission(id)
        if submission["state"] != "scored":
            raise ValueError(
                f"submission {id} is {submission['state']}: {submission['reason_text']}"
            )
        means_by_panel = {score["panel"]: score["figures"]["mean"] for score in client.scores(id)}
        means = ", ".join(f"{panel} {mean:.1f}" for panel, mean in sorted(means_by_panel.items()))
        yield f"{id} is scored ({means}); its receipt is signed: {bool(client.receipt(id))}"


def kill(stage: Stage, service: Service, server: Server) -> Iterator[str]:
    """Kill the server while the season closes; another version must not start in its place."""
    server.process.kill()
    server.process.wait()
    [season] = service.queries.seasons()
    if season.state != "closing":
        raise ValueError(f"the season is {season.state}; it was to be closing when the kill came")
    yield "killed the server while the season closes"
    try:
        server.start(stage.older)
    except ValueError as error:
        if "is closing" not in str(error):
            raise
    else:
        raise ValueError("a server of another version started while the season closes")
    yield f"a server on {stage.older} does not start: the season closes by one version"
    server.start(stage.backend)
    yield f"the server goes on, on {stage.backend}"


def check(stage: Stage, service: Service, visitor: Client, season: str, root: str) -> Iterator[str]:
    """Check the proof, scores and page of a closed season, and make a backup."""
    proof = verify_revealed(visitor, SEASON, root)
    yield f"proved: the {proof['partners']} partners that are revealed are those it opened with"
    played = [score for score in service.queries.scores(season=season) if score.panel == "B"]
    if len(played) != 2:
        raise ValueError(f"panel B has {len(played)} scores; each of two labs entered one")
    if len({score.version for score in played}) != 1:
        raise ValueError("panel B was played by several versions")
    for score in sorted(played, key=lambda score: -score.figures["mean"]):
        yield f"panel B: {score.method} of {score.submitter} earned {score.figures['mean']:.1f}"
    page = visitor.call("GET", f"/seasons/{season}").text
    if not all(score.method in page for score in played):
        raise ValueError("the season's page lacks an entry")
    yield f"the season's page shows them: {visitor.address}/seasons/{season}"
    ledger, counts = check_ledger(visitor), check_service(service)
    yield f"the ledger's {ledger['entries']} entries are a chain"
    yield f"{counts['artefacts']} artefacts and {counts['receipts']} receipts are whole"
    count = back_up(stage.data, stage.folder / "board.zip")
    yield f"a backup has the database, the key and {count} artefacts"


def keep_open(stage: Stage, service: Service) -> None:
    """Extend the season while labs hand in, however busy this machine is."""
    if closing_date(service) < service.clock() + stage.open_seconds / 2:
        service.extend_season(SEASON, service.clock() + stage.open_seconds)


def closing_date(service: Service) -> float:
    """Return when the season that is rehearsed closes."""
    [season] = service.queries.seasons()
    return season.closes_at or 0.0


def state_of(client: Client) -> str:
    """Return the state of the season that is rehearsed."""
    return client.call("GET", f"/api/seasons/{SEASON}").json()["state"]


def watch(client: Client, id: str, meanwhile: Callable[[], Any] = int) -> Iterator[str]:
    """Wait for a submission's end; yield a line when a job of it is done, and every minute.

    Args:
        client: Of its lab.
        id: The submission.
        meanwhile: Called at each look.

    Raises:
        ValueError: It does not end in half an hour.
    """
    end, said, said_at = time.monotonic() + LIMIT_SECONDS, "", 0.0
    while (row := client.submission(id))["state"] not in FINAL_STATES:
        meanwhile()
        now = time.monotonic()
        line = f"{id} is {row['state']}: {row['jobs_done']} of {row['jobs']} jobs done"
        if line != said or now > said_at + SILENT_SECONDS:
            yield line
            said, said_at = line, now
        _pause(f"{id} ends", end)


def wait(what: str, is_so: Callable[[], Any]) -> None:
    """Wait until something is so.

    Raises:
        ValueError: It is not so for half an hour.
    """
    end = time.monotonic() + LIMIT_SECONDS
    while not is_so():
        _pause(what, end)


def _pause(what: str, end: float) -> None:
    if time.monotonic() > end:
        raise ValueError(f"waited {LIMIT_SECONDS / 60:.0f} minutes in vain: {what}")
    time.sleep(0.5)
