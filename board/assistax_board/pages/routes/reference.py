"""The API as a page, made from its OpenAPI document; nothing is fetched from elsewhere."""

from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from assistax_board.pages.site import STILL, Site

GROUPS = {
    "read": "What anybody may read",
    "submit": "With a token that submits",
    "work": "With a token that works",
    "operate": "For the organiser",
}


def reference_router(site: Site) -> APIRouter:
    """Return the route."""
    router = APIRouter(include_in_schema=False)

    @router.get("/docs")
    def docs(request: Request) -> Response:
        def values() -> dict[str, Any]:
            return {"groups": operations(request.app.openapi())}

        return site.page(request, "", STILL, "docs.html", values)

    return router


def operations(schema: dict[str, Any]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Return the operations of an OpenAPI schema by group: method, path, parameters and text."""
    rows: dict[str, list[dict[str, Any]]] = {title: [] for title in GROUPS.values()}
    for path, methods in schema.get("paths", {}).items():
        for method, operation in methods.items():
            tag = next(iter(operation.get("tags", ())), "read")
            parameters = [
                f"{item['name']}{'' if item.get('required') else '?'}"
                for item in operation.get("parameters", ())
                if item["in"] != "path"
            ]
            row = {
                "method": method.upper(),
                "path": path,
                "parameters": ", ".join(parameters),
                "text": operation.get("description", operation.get("summary", "")),
                "has_token": bool(operation.get("security")),
            }
            rows.setdefault(GROUPS.get(tag, tag), []).append(row)
    return [(title, group) for title, group in rows.items() if group]
