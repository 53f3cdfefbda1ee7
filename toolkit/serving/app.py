"""The addresses of `toolkit serve`, over a desk that works on one request at a time."""

from __future__ import annotations

import asyncio
import mimetypes
from collections.abc import AsyncGenerator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar

import jinja2
from fastapi import FastAPI, File, Form, HTTPException, Request, UploadFile
from fastapi.exceptions import RequestValidationError
from fastapi.responses import HTMLResponse, JSONResponse, Response
from pydantic import BaseModel, Field
from starlette.middleware.trustedhost import TrustedHostMiddleware

from toolkit import __version__
from toolkit.errors import ToolkitError
from toolkit.perception.checks.capture import RefusedError
from toolkit.results.answer import COLUMNS
from toolkit.serving.desk import Desk, OutdatedError
from toolkit.serving.door import Door

HOST = "127.0.0.1"
"""The server is there for this machine only: whoever can send may keep it busy."""

ResultT = TypeVar("ResultT")


class Found(BaseModel):
    """What was found wrong with a capture."""

    severity: str = Field(description="refused, doubtful, left out, or said.")
    sentence: str = Field(description="What was measured, its likely cause, and the remedy.")
    cap: float = Field(description="No answer is surer than this.")
    frames: list[int] = Field(description="Current frames that it is about; empty where that is all, or the goal.")


class Looked(BaseModel):
    """What was seen of a scene."""

    scene: int = Field(description="Its number; send it with a goal to be sure which scene is meant.")
    frames: list[int] = Field(description="Indices of the frames that are used.")
    instances: int = Field(description="Objects found in it.")
    findings: list[Found] = Field(description="What is wrong with the frames, worst first.")
    notes: list[str] = Field(description="What reading them left out, changed or did not use.")


class Problem(BaseModel):
    """Why there is no answer."""

    detail: str = Field(description="One sentence: the cause, and the remedy.")


_PROBLEMS: dict[int | str, dict[str, Any]] = {
    400: {"model": Problem, "description": "What was sent cannot be read."},
    409: {"model": Problem, "description": "There is no scene, or another one than is meant."},
    413: {"model": Problem, "description": "The request is too large."},
    422: {"model": Problem, "description": "A part is missing, or the capture cannot be right."},
    503: {"model": Problem, "description": "Too many requests are waiting."},
}


def make_app(desk: Desk, title: str, most_bytes: int, waiting: int) -> FastAPI:
    """The server's application.

    Args:
        desk: does the work; only this application may use it.
        title: of the page: what is served.
        most_bytes: largest request.
        waiting: requests that may wait while one is worked on.
    """
    worker = ThreadPoolExecutor(1, "desk")

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncGenerator[None]:
        yield
        worker.shutdown(wait=False, cancel_futures=True)

    async def done(work: Callable[..., ResultT], *given: Any) -> ResultT:
        return await asyncio.get_running_loop().run_in_executor(worker, work, *given)

    app = FastAPI(title=f"toolkit serve {title}", version=__version__, lifespan=lifespan)
    app.add_middleware(Door, most_bytes=most_bytes, places=waiting + 1)
    # A page elsewhere may give its own name this machine's address.
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    for kind, answer in _ANSWERS.items():
        app.add_exception_handler(kind, answer)
    page = jinja2.Template((Path(__file__).parent / "page.html.j2").read_text(), autoescape=True)

    @app.post("/database", responses=_PROBLEMS)
    async def database(
        capture: Annotated[UploadFile, File(description="A zipped capture folder; its current/ is used.")],
    ) -> Looked:
        """Take a capture's current frames as the scene from now on."""
        return Looked(**await done(desk.look, capture.file))

    @app.post("/estimate", responses=_PROBLEMS)
    async def estimate(
        image: Annotated[UploadFile, File(description="The goal image: PNG, JPEG, TIFF, BMP or WebP.")],
        camera: Annotated[
            str, Form(description="JSON, an entry of scene_camera.json: cam_K, cam_R_w2c, cam_t_w2c (millimetres).")
        ],
        scene: Annotated[int | None, Form(description="Number of the scene that is meant.")] = None,
    ) -> Response:
        """Estimate the motion of every object of the scene towards a goal image: what poses.json holds."""
        return Response(await done(desk.answer, image.file, camera, scene), media_type="application/json")

    @app.get("/answer/{name:path}", responses={404: {"model": Problem}})
    async def file(name: str) -> Response:
        """A file of the last answer, as `toolkit estimate` writes them: poses.json, overlay.png, masks/000000.png."""
        if name not in desk.last.files:
            raise HTTPException(
                404, f"the last answer has no '{name}'; it has {', '.join(desk.last.files) or 'no file'}"
            )
        return Response(desk.last.files[name], media_type=mimetypes.guess_type(name)[0])

    @app.get("/", response_class=HTMLResponse)
    async def last() -> str:
        """The last answer, for people."""
        return page.render(title=title, last=desk.last, columns=COLUMNS)

    return app


async def _bad_request(_: Request, error: Exception) -> JSONResponse:
    status = 422 if isinstance(error, RefusedError) else 409 if isinstance(error, OutdatedError) else 400
    return JSONResponse({"detail": str(error)}, status)


async def _bad_form(_: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    return JSONResponse({"detail": f"'{first['loc'][-1]}': {first['msg'].lower()}; see /openapi.json"}, 422)


async def _broken(_: Request, error: Exception) -> JSONResponse:
    return JSONResponse({"detail": f"the server failed ({type(error).__name__}); its log says where"}, 500)


_ANSWERS = {ToolkitError: _bad_request, RequestValidationError: _bad_form, Exception: _broken}
