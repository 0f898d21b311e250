"""`femu-piezo serve`: the page on this machine, or, with a token, for others."""

from __future__ import annotations

import hashlib
import os
import secrets
import socket
from pathlib import Path

from femu_piezo.errors import InputError
from femu_piezo.web.guard import Guard, is_loopback
from femu_piezo.web.jobs import Jobs
from femu_piezo.web.workspace import Workspace

#: Endings of the files that are served, and their media types.
_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".csv": "text/csv; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".toml": "text/plain; charset=utf-8",
    ".cir": "text/plain; charset=utf-8",
    ".s1p": "text/plain; charset=utf-8",
    ".png": "image/png",
    ".pdf": "application/pdf",
}
#: Seconds that a browser may be silent (asleep, busy, a network that comes and goes) without losing its page.
_AWAY = 30.0


def serve(folder: Path, host: str, port: int, store: str | None = None) -> None:
    """Run the page until Ctrl-C; raises InputError where folder, address, store or packages cannot serve.

    store : database that the commands of the page keep their results in, as `femu_piezo.store.database.Database` takes
        it; "sqlite" for one in the folder
    """
    workspace = Workspace.of(folder)
    if not os.access(workspace.folder, os.W_OK):
        raise InputError(f"{folder}: results are kept in this folder, but it cannot be written to; choose another one")
    os.environ["NICEGUI_STORAGE_PATH"] = str(workspace.own_folder / "browsers")  # read when nicegui is imported
    os.environ.setdefault("MATPLOTLIB", "false")
    try:
        import tomlkit  # noqa: F401  drafts edit TOML with it
        import uvicorn
        from fastapi import FastAPI, HTTPException
        from fastapi.responses import FileResponse, RedirectResponse
        from nicegui import run, ui
    except ImportError:
        raise InputError("the page needs further packages; pip install 'femu-piezo[web]'") from None
    from femu_piezo.web.pages import register
    from femu_piezo.web.site import Site

    listening = _bound(host, port)
    lock = _locked(workspace)  # held until the end
    secret = _secret(workspace.own_folder)
    token = None if is_loopback(host) else hashlib.sha256(f"token {secret}".encode()).hexdigest()[:32]
    jobs = Jobs(workspace.folder, workspace.own_folder, store=store and _checked(store, workspace.folder))
    application = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @application.get("/files/{name:path}")
    def file(name: str) -> FileResponse:
        try:
            path = workspace.path(name)
        except InputError:
            raise HTTPException(404) from None
        kind = _KINDS.get(path.suffix.lower())
        if kind is None or not path.is_file():
            raise HTTPException(404)
        # a page of results runs its own scripts, in a sandbox without access to this page
        return FileResponse(path, media_type=kind, headers={"content-security-policy": _policy(path)})

    @application.get("/")
    def first() -> RedirectResponse:
        return RedirectResponse("/sweep")

    run.process_pool_start_method = "spawn"  # a fork would copy the locks that threads hold
    register(Site(workspace, jobs))
    ui.run_with(
        application, title="femu-piezo", storage_secret=secret, show_welcome_message=False, reconnect_timeout=_AWAY
    )
    everywhere = host in ("0.0.0.0", "::")
    shown = socket.gethostname() if everywhere else f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{port}/" + (f"?token={token}" if token else "")
    print(f"femu-piezo: the page of {workspace.folder} is at {address} (Ctrl-C ends it)", flush=True)
    try:
        settings = uvicorn.Config(Guard(application, token), log_level="warning", ws_max_size=2**24)
        uvicorn.Server(settings).run(sockets=[listening])
    except KeyboardInterrupt:
        pass
    finally:
        jobs.stop()
        lock.close()


def _checked(store: str, folder: Path) -> str:
    """The address of a store, absolute where it is a file; InputError where it does not answer."""
    from femu_piezo.store.database import Database

    database = Database(store, folder)
    database.close()
    return str(database.shown.absolute()) if isinstance(database.shown, Path) else store


def _bound(host: str, port: int) -> socket.socket:
    """A socket at an address; InputError where another program has it."""
    found = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((host, port))
        return found
    except OSError:
        found.close()
        raise InputError(f"port {port} of {host} cannot be used; give another one, such as --port {port + 1}") from None


def _locked(workspace: Workspace):
    """The lock of a folder, which one page at a time has; InputError where another has it."""
    lock = open(workspace.own_folder / "lock", "w")  # noqa: SIM115  held as long as the page runs
    try:
        import fcntl

        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:  # Windows has no such locks
        pass
    except OSError:
        lock.close()
        raise InputError(f"{workspace.folder}: another page shows this folder already; use that one") from None
    return lock


def _policy(path: Path) -> str:
    scripts = "'unsafe-inline'" if path.suffix.lower() == ".html" else "'none'"
    return (
        f"sandbox allow-scripts allow-downloads; default-src 'none'; script-src {scripts}; "
        "style-src 'unsafe-inline'; img-src data: blob: 'self'; frame-ancestors 'self'"
    )


def _secret(own: Path) -> str:
    """The secret of cookies and token, kept so that browsers are known after a restart."""
    file = own / "secret"
    if not file.exists():
        handle = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w") as stream:
            stream.write(secrets.token_urlsafe(32))
    return file.read_text(encoding="utf-8").strip()
