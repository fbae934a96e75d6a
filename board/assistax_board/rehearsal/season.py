"""The course of a rehearsal.

Hidden partners are trained from a private plan, a server with a worker runs as `serve` starts it,
two labs hand robots in over HTTP, the season closes at its date, and anybody's proof is made.
Meanwhile the disk is full for a while, the server is upgraded, rolled back and upgraded again, the
board moves to PostgreSQL and back, and the server is killed while the season closes.
"""

import contextlib
from collections.abc import Iterator

from assistax_board.checking import check_ledger, check_service
from assistax_board.ids import new_id
from assistax_board.rehearsal.disk import small_disk
from assistax_board.rehearsal.hardships import Board, fill_disk, kill, move, roll_back, upgrade
from assistax_board.rehearsal.partners import train_teams
from assistax_board.rehearsal.postgres import cluster, find_binaries, missing
from assistax_board.rehearsal.server import running_server
from assistax_board.rehearsal.stage import SEASON, Stage, wait, watch
from assistax_board.rules.release_pack import add_persons
from assistax_board.rules.seasons import Plan
from assistax_board.serve import open_service
from assistax_board.store.addresses import own_addresses
from assistax_board.store.backup import back_up
from assistax_board.submitting import verify_revealed
from assistax_envs.preferences import preferences_of

HIDDEN_PERSONS = 4  # hidden, where the task has any
STAGES = (
    "train tiny teams: hidden ones, and public ones unless there is a registry",
    "open a season and hand robots in",
    "fill the disk while robots are played",
    "upgrade the server while the season is open",
    "roll the upgrade back, and forward again",
    "move the board to PostgreSQL while the season is open",
    "wait for the closing date, and kill the server while the season closes",
    "play panel B, reveal, prove",
    "move the board back, check it, back it up",
)


def rehearse(stage: Stage) -> Iterator[str]:
    """Rehearse a season, and yield a line about each thing that is done, before or after it.

    Raises:
        ValueError: Something went otherwise than it should in a season.
    """
    from zoo.registry import load_registry

    yield _stage(1)
    yield from _train(stage)
    with contextlib.ExitStack() as stack:
        is_small = stack.enter_context(small_disk(stage.data))
        why, binaries = missing(), find_binaries()
        url = stack.enter_context(cluster(binaries)).url if binaries and not why else None
        service = open_service(stage.data, registry=stage.public, backend=stage.backend)
        plan = Plan(SEASON, stage.task, budget=3, small=True)
        season = service.create_season(plan, stage.private, load_registry(stage.public))
        yield f"starting a server with a worker, on {stage.older}"
        server = stack.enter_context(running_server(stage))
        board = stack.enter_context(Board.opened(stage, service, server))
        yield f"it answers at {server.address}"
        yield _stage(2)
        root = service.open_season(SEASON, service.clock() + stage.open_seconds)
        board.keep_open()
        yield f"season {SEASON} is open; its root is {root}"
        yield from hand_in(board)
        yield _stage(3)
        yield from fill_disk(board, is_small)
        yield _stage(4)
        yield from upgrade(board)
        yield _stage(5)
        yield from roll_back(board)
        yield _stage(6)
        if url is None:
            yield f"left out: {why}"
        else:
            yield from move(board, url.render_as_string(hide_password=False))
        yield _stage(7)
        yield from kill(board)
        yield _stage(8)
        yield from scores_of(board)
        yield from wait("everything is revealed", lambda: board.state() == "closed")
        yield from prove(board, season, root)
        yield _stage(9)
        server.stop()
        yield "the server has stopped, and its workers with it"
        if url is not None:
            yield from move(board, own_addresses(stage.data).database.render_as_string())
        yield from check(board)
    yield "all is as it should be"


def _stage(number: int) -> str:
    return f"stage {number} of {len(STAGES)}, {STAGES[number - 1]}"


def _train(stage: Stage) -> Iterator[str]:
    """Train the teams that are played; draw hidden persons of a task that has any."""
    count = train_teams(stage.private, stage.task, stage.backend, hidden=True)
    yield f"trained {count} hidden teams from a secret plan: {stage.private}"
    if stage.registry is None:
        count = train_teams(stage.public.parent, stage.task, stage.backend, hidden=False)
        yield f"trained {count} public teams: {stage.public}"
    if preferences_of(stage.task):
        add_persons(stage.private, stage.task, HIDDEN_PERSONS)
        yield f"drew {HIDDEN_PERSONS} hidden persons from a secret, beside the teams"


def hand_in(board: Board) -> Iterator[str]:
    """Let two labs hand in a file each, and enter it for panel B."""
    from zoo.exports.policies import policy_file
    from zoo.registry import load_registry

    registry = load_registry(board.stage.public)
    robots = registry.of_task(board.stage.task, "robot")
    for lab, robot, format in (
        ("Lab of Ada", robots[0], "safetensors"),
        ("Lab of Grace", robots[-1], "onnx"),
    ):
        data = policy_file(robot.id, format, lambda: registry)
        client = board.client(board.service.create_token(("submit",), submitter=lab))
        method = robot.team.partition("/")[2]
        fields = {"task": board.stage.task, "method": method, "season": SEASON}
        id = client.submit(data, request_id=new_id(20), **fields)["id"]
        client.enter(SEASON, [id])
        board.submitted.append((client, id))
        yield f"{lab} handed in robot.{format} as {id}, and entered it for panel B"


def scores_of(board: Board) -> Iterator[str]:
    """Wait for the scores of all submissions.

    Raises:
        ValueError: One ended otherwise.
    """
    for client, id in board.submitted:
        yield from watch(client, id)
        submission = client.submission(id)
        if submission["state"] != "scored":
            raise ValueError(
                f"submission {id} is {submission['state']}: {submission['reason_text']}"
            )
        means_by_panel = {score["panel"]: score["figures"]["mean"] for score in client.scores(id)}
        means = ", ".join(f"{panel} {mean:.1f}" for panel, mean in sorted(means_by_panel.items()))
        yield f"{id} is scored ({means}); its receipt is signed: {bool(client.receipt(id))}"


def prove(board: Board, season: str, root: str) -> Iterator[str]:
    """Check the proof, scores and page of a closed season, as anybody can.

    Raises:
        ValueError: Something is otherwise than it should be.
    """
    visitor, queries = board.client(), board.service.queries
    proof = verify_revealed(visitor, SEASON, root)
    yield f"proved: the {proof['partners']} partners that are revealed are those it opened with"
    played = [score for score in queries.scores(season=season) if score.panel == "B"]
    if len(played) != len(board.submitted):
        raise ValueError(f"panel B has {len(played)} scores; each of two labs entered one")
    if len({score.version for score in played}) != 1:
        raise ValueError("panel B was played by several versions")
    for score in sorted(played, key=lambda score: -score.figures["mean"]):
        yield f"panel B: {score.method} of {score.submitter} earned {score.figures['mean']:.1f}"
    page = visitor.call("GET", f"/seasons/{season}").text
    if not all(score.method in page for score in played):
        raise ValueError("the season's page lacks an entry")
    yield f"the season's page shows them: {visitor.address}/seasons/{season}"
    yield f"the ledger's {check_ledger(visitor)['entries']} entries are a chain"


def check(board: Board) -> Iterator[str]:
    """Check the data of a stopped board, and make a backup if it lies in its folder."""
    counts = check_service(board.service)
    yield f"{counts['artefacts']} artefacts and {counts['receipts']} receipts are whole"
    data, backup = board.stage.data, board.stage.folder / "board.zip"
    yield f"a backup has the database, the key and {back_up(data, backup)} artefacts"
