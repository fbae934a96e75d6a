"""The HTTP client of submitters and workers. Its token travels in a header, and nowhere else."""

import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import httpx2

from assistax_board.problems import CODES, Problem
from assistax_board.rules.scoring import Work
from assistax_board.vocabulary import TOKEN_VARIABLE

PATIENCE = 60.0  # seconds for which a server that does not answer is asked again
_AGAIN = (502, 503, 504)


class Client:
    """Speaks with one server; a request that got no answer is sent again.

    Every request that changes something names itself (a submission by its `request_id`, a result by
    its lease), so sending it twice does no harm.
    """

    def __init__(
        self,
        address: str,
        token: str | None = None,
        *,
        transport: Any = None,
        patience: float = PATIENCE,
    ) -> None:
        """Prepare to speak with a server, such as "http://localhost:8800"."""
        self.address, self.token = address.rstrip("/"), token
        self.headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = transport or httpx2.Client(base_url=address, timeout=60.0)
        self._patience = patience

    def call(self, method: str, path: str, **options: Any) -> Any:
        """Return the response to a request.

        Raises:
            Problem: The server does not grant it.
            OSError: It did not answer for as long as patience lasts.
        """
        headers = {**self.headers, **options.pop("headers", {})}
        end, pause = None, 0.2
        while True:
            try:
                response = self._http.request(method, path, headers=headers, **options)
                # Too many readers at one address: a reader can come back later.
                later = response.status_code == 429 and method == "GET"
                # A server that stops ends what is under way so; its own errors are JSON.
                is_text = response.headers.get("content-type", "").startswith("text/plain")
                later |= response.status_code == 500 and is_text
                if response.status_code not in _AGAIN and not later:
                    return _checked(response, self.token)
                error = f"it answered {response.status_code}"
            except httpx2.TransportError as failure:
                error = type(failure).__name__
            # From the first failure, which may come after a minute without an answer.
            end = end or time.monotonic() + self._patience
            if time.monotonic() + pause > end:
                raise OSError(f"the server does not answer ({error}); try again later")
            time.sleep(pause)
            pause = min(2 * pause, 5.0)

    def about(self) -> dict[str, Any]:
        """Return the server's description."""
        return self.call("GET", "/api/about").json()

    def submit(self, data: bytes, **fields: Any) -> dict[str, Any]:
        """Hand in a robot; `fields` are those of `POST /api/submissions`."""
        return self.call("POST", "/api/submissions", params=fields, content=data).json()

    def declare(self, **fields: Any) -> str:
        """Declare an entry and return its id; `fields` are those of `POST /api/entries`."""
        return self.call("POST", "/api/entries", json=fields).json()["id"]

    def limits(self) -> dict[str, Any]:
        """Return the limits of the token's owner."""
        return self.call("GET", "/api/limits").json()

    def submission(self, id: str) -> dict[str, Any]:
        """Return a submission as it stands."""
        return self.call("GET", f"/api/submissions/{id}").json()

    def mine(self, season: str | None = None) -> list[dict[str, Any]]:
        """Return the submissions of the token's owner, the newest first."""
        params = {} if season is None else {"season": season}
        return self.call("GET", "/api/mine", params=params).json()

    def withdraw(self, id: str) -> dict[str, Any]:
        """Take a submission back."""
        return self.call("POST", f"/api/submissions/{id}/withdraw").json()

    def enter(self, season: str, submissions: Sequence[str]) -> list[dict[str, Any]]:
        """Choose the submissions that play a season's panel B."""
        params = {"submission": list(submissions)}
        return self.call("POST", f"/api/seasons/{season}/entries", params=params).json()

    def scores(self, id: str) -> list[dict[str, Any]]:
        """Return the released scores of a submission."""
        return self.call("GET", f"/api/submissions/{id}/scores").json()

    def standing(self, id: str) -> dict[str, Any]:
        """Return the place of a scored submission's method on its board."""
        return self.call("GET", f"/submissions/{id}/standing.json").json()

    def receipt(self, id: str) -> dict[str, Any]:
        """Return the receipt of a scored submission."""
        return self.call("GET", f"/api/submissions/{id}/receipt").json()

    def lease(self, worker: str, versions: tuple[str, ...]) -> Work | None:
        """Take the next job."""
        body = {"worker": worker, "versions": list(versions)}
        response = self.call("POST", "/api/work/lease", json=body)
        if response.status_code == 204:
            return None
        fields: dict[str, Any] = response.json()
        for name in ("partners", "preferences"):
            fields[name] = tuple(fields[name])
        return Work(**fields)

    def beat(self, work: Work) -> bool:
        """Extend the lease of a job; return False if it was lost."""
        return self._about_job("POST", work, "beat").json()["held"]

    def give_back(self, work: Work) -> None:
        """Return a job undone."""
        self._about_job("POST", work, "give-back")

    def failed(self, work: Work) -> None:
        """Return a job that could not be done."""
        self._about_job("POST", work, "failed")

    def refused(self, work: Work, code: str) -> None:
        """End a submission whose robot cannot be played."""
        self._about_job("POST", work, "refused", json={"code": code})

    def result(self, work: Work, data: bytes, seconds: float) -> bool:
        """Bring a result; return False if it was there already."""
        options = {"content": data, "params": {"seconds": seconds}}
        return self._about_job("PUT", work, "result", **options).json()["counted"]

    def artefact(self, sha256: str) -> bytes:
        """Return the bytes of a robot or a release; the caller checks their hash."""
        return self.call("GET", f"/api/work/artefacts/{sha256}").content

    def close(self) -> None:
        """Close the connection."""
        self._http.close()

    def _about_job(self, method: str, work: Work, what: str, **options: Any) -> Any:
        headers = {"X-Lease": work.lease}
        return self.call(method, f"/api/work/{work.job}/{what}", headers=headers, **options)


def _checked(response: Any, token: str | None) -> Any:
    if response.status_code < 400:
        return response
    try:
        error = response.json()["error"]
        code, message = str(error["code"]), str(error["message"])
    except (ValueError, KeyError, TypeError):
        code, message = "invalid", f"the server answered {response.status_code}"
    if code == "not_signed_in" and not token:
        given = f"{TOKEN_VARIABLE} is empty" if token == "" else "no token is given"
        message = f"{given}; write the organiser's token to it, or name its file by --token-file"
    raise Problem(code if code in CODES else "invalid", message)


def fields_of(work: Work) -> dict[str, Any]:
    """Return a piece of work without its secrets, for a log."""
    hidden = ("lease", "seed", "partners", "release", "artefact")
    return {name: value for name, value in dataclasses.asdict(work).items() if name not in hidden}
