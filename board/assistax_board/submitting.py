"""Work of a submitter's command: check at home, hand in, watch, verify."""

import dataclasses
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.digest import sha256
from assistax_board.client import Client
from assistax_board.ids import new_id
from assistax_board.problems import Problem, Refusal
from assistax_board.robots.admission import Admission, robot_sizes
from assistax_board.robots.patience import time_limit
from assistax_board.rules import results, seasons
from assistax_board.rules.catalogue import (
    CHUNK,
    PUBLIC_SEED,
    ZooCatalogue,
    panel_episodes,
    version_id,
)
from assistax_board.rules.scoring import Work, cut
from assistax_board.rules.submissions import MAX_BYTES
from assistax_board.store.played import warning_of
from assistax_board.vocabulary import BACKEND, FINAL_STATES
from assistax_board.work.zoo_scorer import ZooScorer
from assistax_envs.preferences import preferences_of

CHECK_PARTNERS, CHECK_EPISODES = 3, 2
CHECK_SECONDS = 600.0  # of admission, and of each job at home
_TOO_LONG = (
    "the server refuses what takes too long (too_slow): use a smaller network, or give it more "
    "seconds on a busy machine"
)
POLL_SECONDS = 3.0  # fifty watchers at one address are below its rate


def read_file(path: Path) -> bytes:
    """Return a robot's file, or that of a robot of the zoo; one that is too large is not read."""
    if not path.exists() and not path.suffix:
        from zoo.exports.policies import policy_file
        from zoo.registry import load_registry

        return policy_file(str(path), "safetensors", load_registry)
    if not path.is_file():
        raise ValueError(
            f"{path} is not a file; give a .safetensors file, an .onnx file or an id of the zoo"
        )
    if path.stat().st_size > MAX_BYTES:
        raise Refusal("too_large", f"{path.stat().st_size} bytes")
    return path.read_bytes()


def check_file(
    path: Path,
    task: str,
    registry: Path | None = None,
    *,
    whole: bool = False,
    seconds: float = CHECK_SECONDS,
) -> dict[str, Any]:
    """Run the server's admission here, and a few episodes with public partners.

    Args:
        path: The robot's file, or the id of a robot of the zoo.
        task: Task.
        registry: Registry of the public partners instead of the installed one.
        whole: Play the public half as the server does, job by job, and return its figures.
        seconds: By the clock, for the file's admission, and then for each job: what takes longer
            ends this process with an error.

    Raises:
        Refusal: What the server would say.
    """
    from zoo.registry import load_registry

    loaded = load_registry(registry)
    data = read_file(path)
    sizes = robot_sizes(loaded)
    if task not in sizes:
        raise ValueError(f"task is {task!r}; allowed are {', '.join(sizes)}")
    with time_limit(seconds, _TOO_LONG) as say:
        say(f"looking at {path} as the server does")
        format, claimed = Admission(sizes)(data, task)
    catalogue = ZooCatalogue(loaded, BACKEND)
    panel = catalogue.public_panel(task)
    if whole:
        works = _server_works(catalogue, task, format)
    else:
        few = panel[:: max(1, len(panel) // CHECK_PARTNERS)][:CHECK_PARTNERS]
        works = [_try_work(task, format, few)]
    scorer = ZooScorer(loaded, catalogue, BACKEND)
    tables = []
    for number, work in enumerate(works, 1):
        with time_limit(seconds, _TOO_LONG) as say:
            say(f"playing with {len(work.partners)} partners, job {number} of {len(works)}")
            tables.append(scorer.play(work, data, None))
    table = pl.concat([table.sort("partner", "episode") for table in tables])
    answer = {
        "check": "admitted",
        "format": format,
        "partners": sum(len(work.partners) for work in works),
        "episodes": table.height,
        "mean_return": round(float(table["return"].to_numpy().mean()), 1),
        "nonfinite": int(table["nonfinite"].sum()),
    }
    if warning := warning_of(claimed, catalogue.identity(task)["env_version"], None):
        answer["warning"] = warning
    if not whole:
        return answer | {"note": "a few episodes say that it plays, not how well"}
    note = "on a processor of the server's kind these are its figures of the public half"
    version = version_id(catalogue.identity(task))
    return answer | {"version": version, "figures": results.figures(table), "note": note}


def hand_in(
    client: Client,
    files: Sequence[Path],
    fields: dict[str, Any],
    card: dict[str, Any] | None,
    *,
    watch: bool,
) -> list[dict[str, Any]]:
    """Submit a single robot, or an entry of several, and return them as they then stand.

    Args:
        client: Of the server.
        files: Of the robots, or ids of robots of the zoo.
        fields: Of each submission, None where nothing is said.
        card: Of an entry, see `cards.Card`; None of a single robot.
        watch: Whether to wait for the end.
    """
    robots = [read_file(file) for file in files]
    sent = {name: value for name, value in fields.items() if value is not None}
    if card is not None:
        declared = {name: fields[name] for name in ("task", "method", "season")}
        names = [sha256(robot) for robot in robots]
        sent["entry"] = client.declare(request_id=new_id(20), files=names, card=card, **declared)
    submissions = [client.submit(robot, request_id=new_id(20), **sent) for robot in robots]
    for file, submission in zip(files, submissions, strict=True):
        if submission["warning"]:
            print(f"warning: {file}: {submission['warning']}", file=sys.stderr, flush=True)
    if not watch:
        return submissions
    # An entry has its place once all of its seeds are scored.
    ended = [wait_for(client, row["id"]) for row in submissions]
    return [with_scores(client, row) for row in ended]


def watch_submission(client: Client, id: str) -> dict[str, Any]:
    """Wait for a submission's end, and return it with its scores, place and receipt."""
    return with_scores(client, wait_for(client, id))


def wait_for(client: Client, id: str) -> dict[str, Any]:
    """Wait for a submission's end; say place and time left whenever they change."""
    last_line = None
    while True:
        submission = client.submission(id)
        if submission["state"] in FINAL_STATES:
            return submission
        line = f"{submission['state']}, {submission['jobs_done']} of {submission['jobs']} jobs done"
        if submission["place"]:
            line += f", place {submission['place']}, about {submission['eta_seconds']:.0f} s left"
        if line != last_line:
            print(line, file=sys.stderr, flush=True)
            last_line = line
        time.sleep(POLL_SECONDS)


def with_scores(client: Client, submission: dict[str, Any]) -> dict[str, Any]:
    """Return an ended submission; a scored one has its scores, place and receipt beside it."""
    if submission["state"] != "scored":
        return submission
    id = submission["id"]
    scores = {score["panel"]: score["figures"] for score in client.scores(id)}
    standing = {}
    try:
        standing = client.standing(id)
    except (Problem, OSError):  # after an upgrade its board comes later than its score
        print("its place is not known yet; see its page", file=sys.stderr, flush=True)
    return {**submission, **standing, "scores": scores, "receipt": client.receipt(id)}


def for_reader(submission: dict[str, Any], address: str) -> dict[str, Any]:
    """Return the fields of a submission that its submitter reads first; --json has all."""
    shown = {
        name: submission[name] for name in ("id", "state", "reason_text") if submission.get(name)
    }
    for panel, figures in submission.get("scores", {}).items():
        interval = figures.get("mean_ci")
        within = f" ({interval[0]:.1f} to {interval[1]:.1f})" if interval else ""
        shown[f"mean return, {panel}"] = f"{figures['mean']:.1f}{within}"
    if place := submission.get("board_place"):
        lowest = submission.get("board_lowest") or place
        shown["place"] = (
            f"{place if lowest == place else f'{place}–{lowest}'} of {submission['of_methods']} on "
            f"{address}{submission['board']}"
        )
    return shown | {"page": f"{address}/submissions/{submission['id']}"}


def limits_for_reader(limits: dict[str, Any]) -> dict[str, Any]:
    """Return a submitter's limits in a short form; --json has all."""
    requests = f"{limits['requests_left']} of {limits['requests_an_hour']} left this hour"
    shown = {"largest file": f"{limits['file_bytes']} bytes", "requests": requests}
    for season in limits["seasons"]:
        shown[f"season {season['name']}"] = (
            f"{season['left']} of {season['budget']} attempts left on {season['task']}, "
            f"{season['spent']} made, {season['reserved']} under way; {season['plays']}"
        )
    return shown


def verify_revealed(client: Client, name: str, root: str) -> dict[str, Any]:
    """Verify a closed season's release against its root; return the proven facts."""
    statement = client.call("GET", f"/api/seasons/{name}/revealed").json()
    packed = client.call("GET", f"/api/seasons/{name}/release").content
    with tempfile.TemporaryDirectory() as folder:
        count = seasons.verify_season(statement, packed, root, Path(folder))
    return {"season": statement["name"], "root": root, "partners": count, "proved": True}


def _try_work(task: str, format: str, partners: tuple[str, ...]) -> Work:
    """Return a piece of work that no server knows."""
    fields: dict[str, Any] = dict.fromkeys(field.name for field in dataclasses.fields(Work))
    fields |= {"task": task, "kind": "file", "format": format, "panel": "public"}
    fields |= {"partners": partners, "episodes": CHECK_EPISODES, "seed": f"{PUBLIC_SEED + 1:x}"}
    fields["preferences"] = preferences_of(task)
    return Work(**fields)


def _server_works(catalogue: ZooCatalogue, task: str, format: str) -> list[Work]:
    """Return the jobs of a server's public half."""
    played = {
        "episodes": panel_episodes(task, "public"),
        "seed": f"{PUBLIC_SEED:x}",
        "preferences": tuple(catalogue.identity(task).get("preferences", ())),
    }
    return [
        dataclasses.replace(_try_work(task, format, partners), **played)
        for partners in cut(catalogue.public_panel(task), CHUNK)
    ]
