"""Pages of the published partners: their list and cards, pairs with films, and the explorer."""

from typing import Any
from urllib.parse import quote

from fastapi import APIRouter, Form, Request
from starlette.responses import RedirectResponse, Response

from assistax_base.errors import ZooError
from assistax_board.pages import security
from assistax_board.pages.cache import respond
from assistax_board.pages.charts import axis_over
from assistax_board.pages.partners import TRAITS, PartnerCard, choices, choose, list_partners
from assistax_board.pages.rendering import table_rows
from assistax_board.pages.routes.films import ask_for, film_file
from assistax_board.pages.site import STILL, NotFoundError, Site
from assistax_board.pages.videos import ROBOT, Pair
from assistax_envs.persons.rows import COUNT, described_numbers, grades, person
from zoo.partners.person_tables import made_tables

# Of pairs' films; those of robots, whose keys begin so, may have to go: see `films`.
_FOR_EVER = "public, max-age=31536000, immutable"
_BEST = 5  # robots on a card


def partner_router(site: Site) -> APIRouter:
    """Return the routes of the list of partners and of their cards."""
    router = APIRouter(include_in_schema=False)

    @router.get("/tasks/{task}/partners")
    def partners(request: Request, task: str) -> Response:
        traits = {trait: request.query_params.get(trait, "") for trait in TRAITS}

        def values() -> dict[str, Any]:
            partners = list_partners(site.registry, site.task(task), site.crossplays.of(task))
            return {
                "task": task,
                "partners": choose(partners, traits),
                "of": len(partners),
                "choices": choices(partners),
                "wanted": traits,
                "strategies": behaviours(site, task),
                "persons": persons_of(site, task),
            }

        key = f"{task} {sorted(traits.items())}"
        return site.page(request, key, STILL, "partners.html", values)

    @router.get("/partners/{task}/{team}")
    def partner(request: Request, task: str, team: str) -> Response:
        has_numbers = site.registry.source_of(f"{task}/{team}").has_numbers

        def values() -> dict[str, Any]:
            card = person_values if has_numbers else card_values
            return card(site, site.task(task), team)

        template = "person.html" if has_numbers else "partner.html"
        return site.page(request, f"{task} {team}", STILL, template, values)

    return router


def pair_router(site: Site) -> APIRouter:
    """Return the routes of pairs, and of the form that asks for a film."""
    router = APIRouter(include_in_schema=False)

    @router.get("/tasks/{task}/pair")
    def find_pair(task: str, robot: str, human: str) -> Response:
        address = "/".join(quote(part, safe="") for part in (site.task(task), robot, human))
        return RedirectResponse(f"/pairs/{address}", 303)

    @router.get("/pairs/{task}/{robot}/{human}")
    def pair(request: Request, task: str, robot: str, human: str) -> Response:
        return site.form(request, "pair.html", **pair_values(site, site.task(task), robot, human))

    @router.post("/pairs/{task}/{robot}/{human}")
    def film_pair(
        request: Request,
        task: str,
        robot: str,
        human: str,
        form_token: str = Form(default="", alias=security.FIELD),
    ) -> Response:
        pair = find_policies(site, site.task(task), robot, human)
        return ask_for(site, request, pair, form_token)

    return router


def explorer_router(site: Site) -> APIRouter:
    """Return the routes of the explorer, of its numbers, and of films."""
    router = APIRouter(include_in_schema=False)

    @router.get("/tasks/{task}/explorer")
    def explorer(request: Request, task: str) -> Response:
        def values() -> dict[str, Any]:
            crossplay = site.crossplay(task)
            names = {
                side: sorted({policy["team"].partition("/")[2] for policy in crossplay.data[side]})
                for side in ("rows", "columns")
            }
            blocks = {trait: crossplay.blocks(trait) for trait in ("algorithm", "disability")}
            return {"task": task, "crossplay": crossplay, "names": names, "blocks": blocks}

        return site.page(request, task, STILL, "explorer.html", values)

    @router.get("/crossplays/{task}/{digest}/{name}")
    def numbers(request: Request, task: str, digest: str, name: str) -> Response:
        crossplay = site.crossplay(task)
        stem, _, ending = name.rpartition(".")
        if digest == crossplay.digest and name == "matrix.json":
            return respond(request, crossplay.description, immutable=True)
        if digest == crossplay.digest and ending == "f32" and stem in crossplay.measures:
            return respond(request, crossplay.measures[stem], immutable=True)
        raise NotFoundError("These numbers do not exist; open the explorer again.")

    @router.get("/films/{key}")
    def film(key: str) -> Response:
        return film_file(None if key.startswith(ROBOT) else site.videos.film(key), _FOR_EVER)

    @router.get("/films/{key}/episode")
    def episode(key: str) -> Response:
        return film_file(None if key.startswith(ROBOT) else site.videos.episode(key), _FOR_EVER)

    return router


def behaviours(site: Site, task: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the clusters of the humans of a task by behaviour, with their letters."""
    crossplay = site.crossplays.of(task)
    clusters = (crossplay.strategies or {}).get("clusters", []) if crossplay else []
    return [(chr(ord("A") + i), cluster) for i, cluster in enumerate(clusters)]


def card_values(site: Site, task: str, team: str) -> dict[str, Any]:
    """Return the values of a partner's card."""
    crossplay = site.crossplays.of(task)
    partner = _partner(site, task, team)
    robots: list[tuple[str, float]] = []
    teams = [column["team"] for column in crossplay.data["columns"]] if crossplay else []
    if crossplay and partner.team in teams:
        returns = crossplay.values["return"][:, teams.index(partner.team)].tolist()
        names = [row["team"].partition("/")[2] for row in crossplay.data["rows"]]
        robots = sorted(zip(names, returns, strict=True), key=lambda pair: -pair[1])
    training = partner.entry.training.model_dump(exclude={"hyperparameters", "notes"})
    return {
        "task": task,
        "partner": partner,
        "best": robots[:_BEST],
        "worst": robots[-_BEST:] if len(robots) > _BEST else [],
        "training": table_rows(training),
        "hyperparameters": table_rows(partner.entry.training.hyperparameters),
    }


def persons_of(site: Site, task: str) -> list[tuple[str, int]]:
    """Return the name of the first person of each release that has any of a task, and how many."""
    found = made_tables(site.registry.data, task)
    return [(f"person-00000-{release}", table.count) for release, table in found]


def person_values(site: Site, task: str, team: str) -> dict[str, Any]:
    """Return the values of a person's card: each number beside its range."""
    try:
        entry = site.registry.policy(f"{task}/{team}/human")
    except ZooError as error:
        raise NotFoundError(f"There is no person {team!r} of {task}.") from error
    someone = person(task, entry.row)
    near = (entry.row - 1, entry.row + 1)
    numbers = [f"person-{n:05d}-{entry.release}" for n in near if 0 <= n < COUNT]
    return {
        "task": task,
        "name": team,
        "someone": someone,
        "numbers": described_numbers(someone),
        "grades": grades(someone),
        "near": numbers,
        "entry": entry,
    }


def pair_values(site: Site, task: str, robot: str, human: str) -> dict[str, Any]:
    """Return the values of a pair's page."""
    pair = find_policies(site, task, robot, human)
    crossplay = site.crossplays.of(task)
    film, returns = site.videos.film(pair.key), site.videos.returns(pair)
    return {
        "task": task,
        "robot": robot,
        "human": human,
        "row": crossplay.pair(f"{task}/{robot}", f"{task}/{human}") if crossplay else None,
        "measures": crossplay.data["measures"] if crossplay else {},
        "state": site.videos.state(pair),
        "film": f"/films/{pair.key}" if film else None,
        "episode": f"/films/{pair.key}/episode" if site.videos.episode(pair.key) else None,
        "is_gif": film is not None and film.suffix == ".gif",
        "returns": returns,
        "axis": axis_over(returns or [0.0]),
    }


def find_policies(site: Site, task: str, robot: str, human: str) -> Pair:
    """Return a pair of published policies: only of these are films made."""
    try:
        seats = [
            site.registry.policy(f"{task}/{team}/{role}")
            for team, role in ((robot, "robot"), (human, "human"))
        ]
    except ZooError as error:
        raise NotFoundError("There is no such pair of published policies.") from error
    version = site.registry.env_version(seats[0])
    return Pair(task, seats[0].id, seats[1].id, (seats[0].sha256, seats[1].sha256), version)


def _partner(site: Site, task: str, team: str) -> PartnerCard:
    for partner in list_partners(site.registry, task, site.crossplays.of(task)):
        if partner.name == team:
            return partner
    raise NotFoundError(f"There is no partner {team!r} of {task} in its default release.")
