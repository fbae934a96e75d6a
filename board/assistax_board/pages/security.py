"""Protection against foreign pages and scripts: headers, and tokens on forms."""

import hashlib
import hmac
import secrets
from collections.abc import Callable, MutableMapping
from typing import Any

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.responses import Response

# Nothing is inline and nothing comes from elsewhere, so a hostile name could not run if it tried.
CONTENT_SECURITY_POLICY = "; ".join(
    [
        "default-src 'none'",
        *(f"{kind}-src 'self'" for kind in ("script", "style", "img", "media", "connect")),
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    ]
)
HEADERS = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
COOKIE = "assistax_form"
FIELD = "form_token"
NOT_OURS = "This form was not written by this page. Go back, reload it and try again."


class SecurityHeaders:
    """Adds the headers to every answer that has not its own."""

    def __init__(self, app: Callable[..., Any]) -> None:
        self._app = app

    async def __call__(self, scope: MutableMapping, receive: Callable, send: Callable) -> None:
        """Pass a request on, and its answer back with headers."""

        async def send_with_headers(message: MutableMapping) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers if scope["type"] == "http" else send)


class FormTokens:
    """A form is answered only if this server wrote it for this browser.

    The browser keeps a random cookie that no other site can read or send; the form holds a keyed
    hash of it, which nobody else can compute.
    """

    def __init__(self, key: bytes | None = None) -> None:
        self._key = key or secrets.token_bytes(32)

    def issue(self, request: Request, response: Response) -> str:
        """Return the token for a form, and give the browser its cookie if it has none."""
        cookie = request.cookies.get(COOKIE)
        if not cookie:
            cookie = secrets.token_urlsafe(24)
            response.set_cookie(
                COOKIE,
                cookie,
                httponly=True,
                samesite="strict",
                secure=request.url.scheme == "https",
            )
        return self._sign(cookie)

    def may_send(self, request: Request) -> bool:
        """Return whether a request's headers are those of a page of ours: before it is read."""
        from_here = request.headers.get("sec-fetch-site", "same-origin") in ("same-origin", "none")
        return bool(request.cookies.get(COOKIE)) and from_here

    def accepts(self, request: Request, token: str) -> bool:
        """Return whether a form that came with this request was written for its sender."""
        cookie = request.cookies.get(COOKIE, "")
        is_ours = hmac.compare_digest(self._sign(cookie).encode(), token.encode())
        return self.may_send(request) and is_ours

    def _sign(self, cookie: str) -> str:
        return hmac.new(self._key, cookie.encode(), hashlib.sha256).hexdigest()
