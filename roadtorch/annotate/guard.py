"""Who may speak to the page's server, and how much they may say.

The server listens on the loopback interface alone, but every page that a browser shows can send
requests there, and a foreign name can be made to point there (DNS rebinding). So: the Host header
must be the loopback's, the token must come with every request for data, and pages that we send may
load nothing but what we serve.
"""

import secrets
from collections.abc import Awaitable, Callable

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

MOST_BODY = 2 * 2**20  # bytes of one act; ours: a long stroke has some ten thousand

MOST_DRAINED = 64 * 2**20  # bytes of a refused body that are read, so that the refusal arrives

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

Answer = Callable[[Request], Awaitable[Response]]


def refusal(status: int, where: str, what: str, remedy: str) -> JSONResponse:
    """What is wrong, as the page shows it."""
    return JSONResponse({"error": f"{where}: {what} ({remedy})"}, status)


class Guard:
    """Lets requests through that name this host and bear the token."""

    def __init__(self, token: str, port: int) -> None:
        self._token = token
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}

    async def __call__(self, request: Request, answer: Answer) -> Response:
        """The answer, with the headers that every answer has; a refusal where one is due."""
        response = self._refused(request) or await answer(request)
        response.headers.update(HEADERS)
        return response

    def _refused(self, request: Request) -> Response | None:
        host = request.headers.get("host", "")
        if host not in self._hosts:
            return refusal(421, host[:100] or "host", "is not this server", "use 127.0.0.1")
        if request.url.path.startswith("/static/"):
            return None  # public code, the same for everybody
        given = request.headers.get("x-token") or request.query_params.get("token", "")
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            remedy = "open the address that roadtorch annotate printed"
            return refusal(403, "token", "is missing or wrong", remedy)
        return None


async def bounded_body(request: Request) -> bytes | None:
    """The body of a request; None for one of more than ``MOST_BODY`` bytes."""
    body, length = bytearray(), 0
    async for chunk in request.stream():
        length += len(chunk)
        if length <= MOST_BODY:
            body += chunk
        if length > MOST_DRAINED:
            break
    return bytes(body) if length <= MOST_BODY else None
