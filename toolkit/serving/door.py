"""The door of the server: how large a request may be, how many may wait, and from where."""

from __future__ import annotations

from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_RETRY_S = 5


class Door:
    """Lets requests with a body in, as many at a time as there are places; others are answered at once.

    A page of another origin is kept out: a browser would send it here without being asked.

    Args:
        app: behind the door.
        most_bytes: largest body.
        places: requests that are worked on, or wait, at the same time.
    """

    def __init__(self, app: ASGIApp, most_bytes: int, places: int) -> None:
        self._app = app
        self._most_bytes = most_bytes
        self._free = self._places = places

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "POST":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        origin, length = headers.get("origin"), headers.get("content-length", "0")
        if origin is not None and urlsplit(origin).netloc != headers.get("host"):
            await _answer(403, f"a page of {origin} may not send anything here")(scope, receive, send)
        elif length.isdecimal() and int(length) > self._most_bytes:
            await _answer(413, self._too_large)(scope, receive, send)
        elif not self._free:
            # Read to its end, or the client sees a broken connection in place of the answer.
            receive = self._counted(receive)
            while (await receive()).get("more_body"):
                pass
            sentence = f"{self._places} requests are waiting already; send it again in {_RETRY_S} s"
            await _answer(503, sentence, {"Retry-After": str(_RETRY_S)})(scope, receive, send)
        else:
            self._free -= 1
            try:
                await self._app(scope, self._counted(receive), send)
            finally:
                self._free += 1

    def _counted(self, receive: Receive) -> Receive:
        left = self._most_bytes

        async def counted() -> Message:
            nonlocal left
            message = await receive()
            left -= len(message.get("body", b""))
            if left < 0:
                raise HTTPException(413, self._too_large)
            return message

        return counted

    @property
    def _too_large(self) -> str:
        return f"the request is larger than {self._most_bytes / 2**20:.0f} MiB"


def _answer(status: int, sentence: str, headers: dict[str, str] | None = None) -> JSONResponse:
    return JSONResponse({"detail": sentence}, status, headers)
