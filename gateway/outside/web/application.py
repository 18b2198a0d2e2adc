"""The page as an ASGI application: the document, its files, the REST interface and the one stream of events."""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from hashlib import sha256
from http import HTTPStatus
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gateway.machine.alarms import FLOOD_BEGIN_COUNT, TEN_MINUTES
from gateway.outside.status import ControlError
from gateway.outside.texts import LANGUAGES
from gateway.outside.web.api import (
    COOKIE,
    ENDPOINTS,
    Endpoint,
    answer_request,
    as_json,
    choose_language,
    client_address,
)
from gateway.outside.web.state import PageState
from sim.strict_json import json_text

STATIC = Path(__file__).parent / "static"
TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".LICENSE": "text/plain"}
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]", "::1")
"""What a browser on this machine may call it: another name that leads here is another site's trick (DNS rebinding)."""

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
}
YEAR_S = 31_536_000


class SecureHeaders:
    """Puts the headers that every response has on it; nothing is kept by a browser unless a response says so."""

    def __init__(self, app: ASGIApp, *, tls: bool) -> None:
        self._app = app
        strict = {"strict-transport-security": f"max-age={YEAR_S}"} if tls else {}
        self._headers = [(name.encode(), value.encode()) for name, value in {**HEADERS, **strict}.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                there = {name.lower() for name, _ in message["headers"]}
                kept = [] if b"cache-control" in there else [(b"cache-control", b"no-store")]
                message["headers"] = [*message["headers"], *self._headers, *kept]
            await send(message)

        await self._app(scope, receive, with_headers)


class EventStream:
    """A response that never ends by itself: the live stream, for as long as its client listens and may."""

    def __init__(self, page: PageState, language: str, secret: str, address: str) -> None:
        self._page, self._language, self._secret, self._address = page, language, secret, address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        # A place is had before anything is waited for: of many who come at once none is let in by the same free one.
        places, ended = self._page.live.places, asyncio.Event()
        if not places.take(ended, self._address):
            refusal = as_json({"reason": f"{len(places)} browsers follow already"}, HTTPStatus.SERVICE_UNAVAILABLE)
            await refusal(scope, receive, send)
            return
        try:
            await self._follow(receive, send, ended)
        finally:
            places.release(ended)

    async def _follow(self, receive: Receive, send: Send, ended: asyncio.Event) -> None:
        async def await_disconnect() -> None:
            while (await receive())["type"] != "http.disconnect":
                pass

        async def events() -> None:
            async for event in self._page.live.follow(self._language):
                # A session that has ended reads no more.
                if not self._page.reading_is_open and self._page.sessions.find(self._secret) is None:
                    return
                await send({"type": "http.response.body", "body": event, "more_body": True})

        headers = [(b"content-type", b"text/event-stream"), (b"x-accel-buffering", b"no")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        tasks = {asyncio.ensure_future(work()) for work in (await_disconnect, events, ended.wait)}
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        await send({"type": "http.response.body", "body": b"", "more_body": False})


def static_files() -> dict[str, tuple[bytes, str, str]]:
    """Every file of the page by its path below /static: content, type, and what its content is known by.

    They are read once: no request leads to the file system, whatever its path says.
    """
    files = {}
    for path in sorted(STATIC.rglob("*")):
        if path.is_file():
            content = path.read_bytes()
            name = path.relative_to(STATIC).as_posix()
            files[name] = (content, TYPES[path.suffix], sha256(content).hexdigest()[:16])
    return files


def make_application(page: PageState, failed: Callable[[str, Exception], None]) -> ASGIApp:
    """The application.

    `failed` is told the path of a request that could not be answered, and why: that is a defect, and never silent.
    """
    files = static_files()
    # A browser keeps each file for as long as its content is the same.
    version = sha256("".join(known for _, _, known in files.values()).encode()).hexdigest()[:12]
    pages = Environment(
        loader=PackageLoader("gateway.outside.web"),
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = pages.get_template("page.html.j2")

    async def document(request: Request) -> Response:
        language = choose_language(request)
        session = page.sessions.find(request.cookies.get(COOKIE, "")[:200])
        state: Mapping[str, Any] | None = None
        if page.reading_is_open or session is not None:
            try:
                state = await page.plant(language)
            except ControlError:
                state = None  # the stream says what there is to say
        start = {
            "language": language,
            "texts": page.words[language].texts,
            "open": page.reading_is_open,
            "may_read": page.reading_is_open or session is not None,
            "flood": {"count": FLOOD_BEGIN_COUNT, "span_s": TEN_MINUTES},
            "state": state,
        }
        # Within a script element only `<` could end it.
        data = Markup(json_text(start).replace("<", "\\u003c"))  # noqa: S704 - it is no script, and nothing ends it
        text = template.render(
            language=language, languages=LANGUAGES, words=page.words[language].texts, version=version, start=data
        )
        response = Response(text, media_type="text/html")
        if request.query_params.get("lang") in LANGUAGES:
            response.set_cookie("decanter_language", language, max_age=YEAR_S, samesite="strict", httponly=True)
        return response

    async def static(request: Request) -> Response:
        found = files.get(request.path_params["path"])
        if found is None:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        content, kind, known = found
        headers = {"etag": f'"{known}"', "cache-control": "no-cache"}
        if request.query_params.get("v") == version:
            headers["cache-control"] = f"max-age={YEAR_S}, immutable"
        if request.headers.get("if-none-match") == headers["etag"]:
            return Response(None, HTTPStatus.NOT_MODIFIED, headers)
        return Response(content, headers=headers, media_type=kind)

    async def live(request: Request) -> Response | EventStream:
        secret = request.cookies.get(COOKIE, "")[:200]
        if not page.reading_is_open and page.sessions.find(secret) is None:
            return as_json({"reason": "log in first"}, HTTPStatus.UNAUTHORIZED)
        return EventStream(page, choose_language(request), secret, client_address(request))

    async def refuse(_: Request, error: Exception) -> Response:
        status = HTTPStatus(error.status_code) if isinstance(error, HTTPException) else HTTPStatus.BAD_REQUEST
        return as_json({"reason": status.phrase.lower()}, status)

    async def defect(request: Request, error: Exception) -> Response:
        failed(request.url.path[:100], error)
        headers = {**HEADERS, "cache-control": "no-store"}
        return as_json(
            {"reason": "this request has failed; the log says why"}, HTTPStatus.INTERNAL_SERVER_ERROR, headers
        )

    def endpoint_route(endpoint: Endpoint) -> BaseRoute:
        return Route(endpoint.path, partial(answer_request, page, endpoint), methods=[endpoint.method])

    routes: list[BaseRoute] = [
        Route("/", document),
        Route("/api/live", live),
        Route("/static/{path:path}", static),
        *(endpoint_route(endpoint) for endpoint in ENDPOINTS),
    ]
    names = LOOPBACK_NAMES if page.config.page.loopback else ("*",)
    middleware = [
        Middleware(SecureHeaders, tls=page.config.page.certificates is not None),
        Middleware(TrustedHostMiddleware, allowed_hosts=list(names), www_redirect=False),
    ]
    return Starlette(
        routes=routes, middleware=middleware, exception_handlers={HTTPException: refuse, Exception: defect}
    )
