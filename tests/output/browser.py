"""A page in headless Chromium, driven through its debugging port: real mouse events, console messages, screenshots."""

from __future__ import annotations

import asyncio
import base64
import json
import subprocess
import urllib.request
from pathlib import Path

from tornado.websocket import websocket_connect

_FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --hide-scrollbars --remote-debugging-port=0"
)


class Browser:
    """One tab. Use as `async with Browser(program, profile) as tab`."""

    def __init__(self, program: str, profile: Path, size: tuple[int, int] = (1100, 900)) -> None:
        self._command = [program, *_FLAGS.split(), f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}"]
        self._profile, self._number = profile, 0
        self.console: list[str] = []
        self.events: list[str] = []

    async def __aenter__(self) -> Browser:
        self._process = subprocess.Popen([*self._command, "about:blank"], stderr=subprocess.DEVNULL)
        port = await self._port()
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            tabs = json.load(answer)
        self._socket = await websocket_connect(next(t["webSocketDebuggerUrl"] for t in tabs if t["type"] == "page"))
        for domain in ("Page", "Runtime", "Log"):
            await self.send(f"{domain}.enable")
        return self

    async def __aexit__(self, *_) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(20)

    async def _port(self) -> int:
        file = self._profile / "DevToolsActivePort"
        for _ in range(200):
            if file.is_file() and file.read_text():
                return int(file.read_text().splitlines()[0])
            await asyncio.sleep(0.1)
        raise TimeoutError("the browser did not open its debugging port")

    async def send(self, method: str, **parameters) -> dict:
        """Call a method of the DevTools protocol and wait for its answer; events on the way are kept."""
        self._number += 1
        await self._socket.write_message(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(await asyncio.wait_for(self._socket.read_message(), 60))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._keep(message)

    def _keep(self, message: dict) -> None:
        self.events.append(message["method"])
        if message["method"] in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
            self.console.append(json.dumps(message["params"]))

    async def open(self, path: Path) -> None:
        """Load a file and wait until it has been drawn."""
        await self.send("Page.navigate", url=path.resolve().as_uri())
        while await self.value("document.readyState") != "complete" or not await self.value(
            "location.protocol=='file:'"
        ):
            await asyncio.sleep(0.1)

    async def value(self, expression: str):
        """The value of a JavaScript expression."""
        answer = await self.send("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def mouse(self, kind: str, x: float, y: float, clicks: int = 1) -> None:
        """kind: "mousePressed", "mouseMoved" or "mouseReleased", in pixels of the window."""
        button = "left" if kind != "mouseMoved" else "none"
        await self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=clicks)

    async def screenshot(self, path: Path) -> None:
        """What the window shows, as PNG."""
        answer = await self.send("Page.captureScreenshot")
        path.write_bytes(base64.b64decode(answer["data"]))
