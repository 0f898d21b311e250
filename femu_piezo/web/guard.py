"""Which requests the page answers: those of this machine and of its own pages; from elsewhere, those with the token."""

from __future__ import annotations

import hmac
import ipaddress
from http.cookies import SimpleCookie
from urllib.parse import parse_qsl, urlencode, urlsplit

_COOKIE = "femu_piezo_token"
_LARGEST_BODY = 60_000_000
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"SAMEORIGIN"),
)
#: Nothing is fetched from other servers; the page needs inline styles, and compiles its templates (unsafe-eval).
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; "
    "frame-src 'self'; frame-ancestors 'self'; form-action 'self'; base-uri 'self'; object-src 'none'"
)


def is_loopback(host: str) -> bool:
    """Whether a host name means this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Guard:
    """ASGI middleware: refuses foreign hosts and origins, large bodies, and requests without the token.

    Parameters
    ----------
    app : the application that it guards
    token : required once in the address ("?token=…"), from then on in a cookie; where None, no token is required
    """

    def __init__(self, app, token: str | None = None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope, receive, send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.lower(): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _refuse(scope, receive, send, *refusal)
        elif scope["type"] == "http" and (place := self._without_token(scope)) is not None:
            await _redirect(send, place, self._token)
        else:
            http = scope["type"] == "http"
            await self._app(scope, _limited(receive) if http else receive, _with_headers(send) if http else send)

    def _refusal(self, scope, headers: dict[bytes, str]) -> tuple[int, str] | None:
        host = headers.get(b"host", "")
        origin = headers.get(b"origin")
        try:
            name, source = urlsplit(f"//{host}").hostname or "", urlsplit(origin or "").netloc
        except ValueError:  # brackets that hold no address
            return 400, "the host or the origin of this request is no address"
        # a foreign name that resolves to this machine would give a foreign page our origin (DNS rebinding)
        if self._token is None and not is_loopback(name):
            return 403, "this page can be opened on this machine only"
        if origin is not None and source != host:
            return 403, "requests from other pages are refused"
        if self._token is not None and not self._has_token(scope, headers):
            return 403, "open the address with its token, as the terminal shows it"
        length = headers.get(b"content-length", "0")
        if not length.isdigit() or int(length) > _LARGEST_BODY:
            return 413, f"a request may have {_LARGEST_BODY / 1e6:.0f} MB at most"
        return None

    def _has_token(self, scope, headers: dict[bytes, str]) -> bool:
        cookie = SimpleCookie(headers.get(b"cookie", "")).get(_COOKIE)
        given = [
            cookie.value if cookie else "",
            dict(parse_qsl(scope["query_string"].decode("latin-1"))).get("token", ""),
        ]
        return any(hmac.compare_digest(one.encode(), self._token.encode()) for one in given)

    def _without_token(self, scope) -> str | None:
        """The address without its token; None where it has none."""
        pairs = parse_qsl(scope["query_string"].decode("latin-1"))
        if self._token is None or not any(key == "token" for key, _ in pairs):
            return None
        rest = urlencode([(key, value) for key, value in pairs if key != "token"])
        return scope["path"] + (f"?{rest}" if rest else "")


async def _refuse(scope, receive, send, status: int, words: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": words})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": f"femu-piezo: {words}\n".encode()})


async def _redirect(send, place: str, token: str) -> None:
    cookie = f"{_COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/"
    # a path that begins with two slashes would be the address of another host
    headers = [(b"location", ("/" + place.lstrip("/")).encode("latin-1")), (b"set-cookie", cookie.encode("latin-1"))]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


def _limited(receive):
    """`receive`, which breaks off a body that grows beyond `_LARGEST_BODY`, as one that states no length may."""
    taken = 0

    async def receiving():
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        return message if taken <= _LARGEST_BODY else {"type": "http.disconnect"}

    return receiving


def _with_headers(send):
    async def sending(message) -> None:
        if message["type"] == "http.response.start":
            given = {name.lower() for name, _ in message["headers"]}
            added = [(name, value) for name, value in _HEADERS if name not in given]
            if b"content-security-policy" not in given:
                added.append((b"content-security-policy", _POLICY.encode()))
            message = {**message, "headers": [*message["headers"], *added]}
        await send(message)

    return sending
