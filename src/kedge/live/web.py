"""The web server: the page, what it is told, and the frames.

Needs ``pip install 'kedge-nav[live]'``. With a token every request but ``/ready`` must bring
it, as ``?token=`` or ``Authorization: Bearer``.
"""

import asyncio
import contextlib
import hmac
import json
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import JSONResponse, PlainTextResponse
from fastapi.staticfiles import StaticFiles

from kedge.core.errors import DataError
from kedge.live.describe import describe
from kedge.live.service import Service

PAGE = Path(__file__).parent / "page"
WAITING = 20
"""Frames that a slow page may be behind; it loses whole ones beyond."""
STALE = 2.0
"""s without a frame, after which the service is not healthy."""
LONGEST = 4096
"""Characters of a page's message."""
POLICY = "default-src 'self'; connect-src 'self'; object-src 'none'; frame-ancestors 'none'"


def application(service: Service, token: str | None = None) -> FastAPI:
    """The server's application; it starts the service and stops it."""
    about = describe(service.fleet)

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        service.start()
        try:
            yield
        finally:
            service.stop()

    app = FastAPI(
        title="kedge", lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None
    )

    @app.middleware("http")
    async def guard(request: Request, call: Any) -> Response:
        if request.url.path != "/ready" and not _allowed(request, token):
            return JSONResponse({"error": "expected the token"}, 401)
        answer = await call(request)
        answer.headers["Content-Security-Policy"] = POLICY
        answer.headers["X-Content-Type-Options"] = "nosniff"
        return answer

    @app.get("/v1/describe")
    async def description() -> JSONResponse:
        return JSONResponse(about)

    @app.get("/ready")
    async def ready() -> JSONResponse:
        good = service.newest is not None
        return JSONResponse({"ready": good}, 200 if good else 503)

    @app.get("/health")
    async def health() -> JSONResponse:
        newest = service.newest
        age = None if newest is None else time.monotonic() - newest
        good = service.failure is None and age is not None and age < STALE
        names = [vehicle["name"] for vehicle in about["vehicles"]]
        content = {
            "healthy": good,
            "failure": service.failure,
            "frames": service.frames,
            "age_s": age,
            "vehicles": dict(zip(names, service.statuses, strict=False)),
        }
        return JSONResponse(content, 200 if good else 503)

    @app.websocket("/v1/page")
    async def page(socket: WebSocket) -> None:
        if not _allowed(socket, token) or not _same_origin(socket):
            await socket.close(1008)
            return
        await socket.accept()
        await _serve_page(socket, service)

    if (PAGE / "index.html").exists():
        app.mount("/", StaticFiles(directory=PAGE, html=True))
    else:

        @app.get("/")
        async def no_page() -> PlainTextResponse:
            return PlainTextResponse("kedge: /v1/describe, /health, and frames at /v1/page\n")

    return app


def _allowed(request: Request | WebSocket, token: str | None) -> bool:
    if token is None:
        return True
    bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
    given = request.query_params.get("token") or bearer
    return hmac.compare_digest(given.encode(), token.encode())


def _same_origin(socket: WebSocket) -> bool:
    """No page of another site may listen through a browser; programs send no origin."""
    origin = socket.headers.get("origin")
    return origin is None or origin.split("://")[-1] == socket.headers.get("host")


async def _serve_page(socket: WebSocket, service: Service) -> None:
    """Frames to one page, and what it asks for, until it leaves."""
    loop, waiting = asyncio.get_running_loop(), asyncio.Queue[bytes](WAITING)

    def put(frame: bytes) -> None:
        if not waiting.full():
            waiting.put_nowait(frame)

    def listener(frame: bytes) -> None:
        loop.call_soon_threadsafe(put, frame)

    leave = service.listen(listener)

    async def send() -> None:
        while True:
            await socket.send_bytes(await waiting.get())

    async def receive() -> None:
        while True:
            refusal = _obeyed(service, await socket.receive_text())
            if refusal:
                await socket.send_text(json.dumps({"error": refusal}))

    tasks = [asyncio.create_task(send()), asyncio.create_task(receive())]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                task.result()
    finally:
        leave()
        for task in tasks:
            task.cancel()


def _obeyed(service: Service, text: str) -> str | None:
    """Hand on what a page sent; why not, if it is refused."""
    try:
        if len(text) > LONGEST:
            raise DataError(f"found {len(text)} characters, expected at most {LONGEST}")
        message = json.loads(text)
        # All details go to every page, so that nothing is to be selected.
        if not (isinstance(message, dict) and set(message) == {"select"}):
            service.command(message)
    except json.JSONDecodeError as error:
        return f"not JSON: {error}"
    except DataError as error:
        return str(error)
    return None
