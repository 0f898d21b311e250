"""Access to the page over real sockets: strangers, foreign origins and host names, paths outside the folder, and
sizes.
"""

from __future__ import annotations

import http.client
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from femu_piezo.web.guard import is_loopback


def ask(
    port: int, path: str, headers: dict[str, str] | None = None, host: str | None = None
) -> tuple[int, dict, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
    connection.putheader("Host", host or f"127.0.0.1:{port}")
    for name, value in (headers or {}).items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()


def websocket(port: int, origin: str) -> int:
    """Status of the answer to a request for a websocket."""
    with socket.create_connection(("127.0.0.1", port), timeout=20) as stream:
        lines = [
            "GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version: 13",
            f"Origin: {origin}",
        ]
        stream.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(stream.recv(200).split()[1])


def test_this_machine_alone_is_answered(serve, tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results/report.html").write_text("<script>1</script>")
    (tmp_path / "results/circuit.cir").write_text(".subckt")
    (tmp_path / "results/x.py").write_text("secret")
    (tmp_path.parent / "outside.csv").write_text("secret")
    (tmp_path / "link.csv").symlink_to(tmp_path.parent / "outside.csv")
    port = serve().port
    status, headers, _ = ask(port, "/sweep")
    assert status == 200 and "connect-src 'self'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert ask(port, "/sweep", host="evil.example")[0] == 403  # a foreign host name that resolves to this machine
    assert ask(port, "/sweep", host=f"localhost:{port}")[0] == 200
    assert ask(port, "/sweep", host="[")[0] == ask(port, "/sweep", {"Origin": "http://["})[0] == 400  # no addresses
    assert ask(port, "/sweep", {"Origin": "http://evil.example"})[0] == 403
    assert ask(port, "/sweep", {"Origin": "null"})[0] == 403
    assert websocket(port, "http://evil.example") == 403
    assert websocket(port, f"http://127.0.0.1:{port}") == 101
    status, headers, body = ask(port, "/files/results/report.html")
    assert status == 200 and body.startswith(b"<script>") and "sandbox" in headers["content-security-policy"]
    assert ask(port, "/files/results/circuit.cir")[0] == 200
    own = os.listdir(tmp_path / ".femu-piezo")[0]
    for path in (
        "../outside.csv",
        "..%2foutside.csv",
        "%2e%2e/outside.csv",
        "%2fetc%2fpasswd",
        "/etc/passwd",
        "link.csv",
        "results/x.py",
        f".femu-piezo/{own}",
        "results/../.femu-piezo/secret",
        "none.csv",
        "results",
        "x%00.csv",
    ):
        status, _, body = ask(port, f"/files/{path}")
        assert status == 404 and b"secret" not in body, path
    assert ask(port, "/sweep", {"Content-Length": "99000000"})[0] == 413


def test_others_need_the_token_that_the_terminal_shows(serve) -> None:
    server = serve("--host", "0.0.0.0")
    token = server.address.partition("token=")[2]
    assert len(token) > 24
    for path in ("/sweep", "/sweep?token=guess", "/files/x.csv", "/_nicegui_ws/socket.io/"):
        assert ask(server.port, path)[0] == 403, path
    assert websocket(server.port, f"http://127.0.0.1:{server.port}") == 403
    status, headers, _ = ask(server.port, f"/sweep?file=a.csv&token={token}")
    assert status == 303 and headers["location"] == "/sweep?file=a.csv"
    cookie = headers["set-cookie"].partition(";")[0]
    assert "HttpOnly" in headers["set-cookie"] and "SameSite=Strict" in headers["set-cookie"]
    assert ask(server.port, "/sweep", {"Cookie": cookie})[0] == 200
    assert ask(server.port, "/sweep", {"Cookie": cookie, "Origin": "http://evil.example"})[0] == 403
    assert ask(server.port, f"//evil.example?token={token}")[1]["location"] == "/evil.example"
    server.stop()
    assert serve("--host", "0.0.0.0").address.partition("token=")[2] == token  # the token stays valid over a restart


def test_a_folder_has_one_page(serve, tmp_path: Path) -> None:
    serve()
    order = [sys.executable, "-m", "femu_piezo.cli", "serve", str(tmp_path), "--port", str(_free_port())]
    run = subprocess.run(order, capture_output=True, text=True, timeout=60)
    assert run.returncode == 2 and "another page shows this folder already" in run.stderr


def test_a_body_without_length_is_not_read_to_its_end(serve) -> None:
    server = serve()
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as stream:
        head = f"POST /sweep HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nTransfer-Encoding: chunked\r\n\r\n"
        stream.sendall(head.encode())
        piece = b"%x\r\n" % 2**20 + bytes(2**20) + b"\r\n"
        try:
            for _ in range(100):
                stream.sendall(piece)
            answered = stream.recv(100)
        except (ConnectionError, TimeoutError):
            answered = b""
    assert not answered.startswith(b"HTTP/1.1 200")
    assert ask(server.port, "/sweep")[0] == 200


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_wrong_folders_and_ports_are_one_sentence(tmp_path: Path, serve) -> None:
    port = serve().port
    for arguments, words in (
        ((str(tmp_path / "none"),), "no such folder"),
        ((str(tmp_path), "--port", str(port)), "cannot be used; give another one"),
        ((str(tmp_path), "--port", "70000"), "70000"),
    ):
        order = [sys.executable, "-m", "femu_piezo.cli", "serve", *arguments]
        run = subprocess.run(order, capture_output=True, text=True, timeout=60)
        assert run.returncode == 2 and words in run.stderr and "Traceback" not in run.stderr, run.stderr


@pytest.mark.parametrize(
    ("host", "ours"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("lab", False)]
)
def test_which_addresses_are_this_machine(host: str, ours: bool) -> None:
    assert is_loopback(host) == ours
