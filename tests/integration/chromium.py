"""A headless Chromium of the system, driven over its DevTools protocol."""

from __future__ import annotations

import base64
import io
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from websockets.sync.client import ClientConnection, connect

PATIENCE_S = 90.0  # a page drawn by the processor alone, on two cores that others use
LOOK_S = 0.2


class Browser:
    """One page.

    Attributes:
        requests: Addresses that the page has asked for, of websockets too.
        blocked: What its content security policy has refused.
    """

    def __init__(self, pipe: ClientConnection) -> None:
        self._pipe = pipe
        self._numbers = itertools.count(1)
        self.requests: list[str] = []
        self.blocked: list[str] = []
        for domain in ("Network", "Page", "Runtime", "Log"):
            self._ask(f"{domain}.enable")

    def _ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._pipe.send(json.dumps({"id": number, "method": method, "params": parameters}))
        deadline = time.monotonic() + PATIENCE_S
        while True:
            message = json.loads(self._pipe.recv(timeout=deadline - time.monotonic()))
            if message.get("id") == number:
                assert "error" not in message, message
                found: dict[str, Any] = message["result"]
                return found
            self._hear(message)

    def _hear(self, message: dict[str, Any]) -> None:
        told = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(told["request"]["url"])
            case "Network.webSocketCreated":
                self.requests.append(told["url"])
            case "Log.entryAdded" if told["entry"]["source"] == "security":
                self.blocked.append(told["entry"]["text"])

    def open(self, url: str) -> None:
        """Go to an address."""
        self._ask("Page.navigate", url=url)

    def evaluate(self, script: str) -> Any:
        """Return the value of a script."""
        found = self._ask("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    @property
    def text(self) -> str:
        """What the page says."""
        return str(self.evaluate("document.body ? document.body.innerText : ''"))

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition.

        Raises:
            TimeoutError: It did not come about; with what the page says.
        """
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what}; the page says: {self.text}")
            time.sleep(LOOK_S)

    def until_said(self, text: str) -> None:
        """Wait for a text on the page."""
        self.until(lambda: text in self.text, text)

    def click(self, label: str) -> None:
        """Click the button with this label, with the mouse."""
        script = f"""(() => {{
            const found = [...document.querySelectorAll('button')].filter(
                b => b.innerText.trim() === {json.dumps(label)} && b.offsetParent !== null);
            if (found.length !== 1) return null;
            found[0].scrollIntoView({{block: 'center'}});
            const r = found[0].getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2];
        }})()"""
        self.until(lambda: self.evaluate(script), f"a button '{label}'")
        self._press(*self.evaluate(script))

    def _press(self, x: float, y: float) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def choose(self, label: str, value: str) -> None:
        """Choose a value from the first list with this label, by keyboard and mouse."""
        box = f"""(() => {{
            const found = [...document.querySelectorAll('label')].find(
                l => l.innerText.trim() === {json.dumps(label)});
            const list = found && document.getElementById(found.htmlFor);
            if (!list) return null;
            list.scrollIntoView({{block: 'center'}});
            const r = list.getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2];
        }})()"""
        option = f"""(() => {{
            const found = [...document.querySelectorAll('[role=option]')].find(
                o => o.innerText.trim() === {json.dumps(value)} && o.offsetParent !== null);
            if (!found) return null;
            const r = found.getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2];
        }})()"""
        for place in (box, option):
            self.until(lambda place=place: self.evaluate(place), f"{label}: {value}")
            self._press(*self.evaluate(place))

    def type(self, label: str, text: str) -> None:
        """Write a text into the last field that stands with this label, and leave it."""
        field = f"""(() => {{
            const found = [...document.querySelectorAll('label')].find(
                l => l.innerText.trim() === {json.dumps(label)});
            let box = found && found.parentElement;
            while (box && !box.querySelector('input[type=text]')) box = box.parentElement;
            const input = box && [...box.querySelectorAll('input[type=text]')].shift();
            if (!input) return false;
            input.focus(); input.select();
            return true;
        }})()"""
        self.until(lambda: self.evaluate(field), f"a field '{label}'")
        self._ask("Input.insertText", text=text)
        for kind in ("keyDown", "keyUp"):
            self._ask("Input.dispatchKeyEvent", type=kind, key="Enter", windowsVirtualKeyCode=13)

    def screenshot(self) -> NDArray[np.uint8]:
        """Return what is seen, (height, width, 3)."""
        data = base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def outside(self) -> list[str]:
        """Return the requests that left the machine."""
        self.evaluate("1")  # hears what has come meanwhile
        here = ("data", "blob", "chrome", "about")
        return [
            url
            for url in self.requests
            if urlsplit(url).scheme not in here and urlsplit(url).hostname != "127.0.0.1"
        ]


@contextmanager
def chromium(folder: Path, width: int = 1000, height: int = 800) -> Iterator[Browser]:
    """Start a browser with a profile of its own; it is gone at the end."""
    program = shutil.which("chromium")
    assert program, "no chromium here: apt-get install chromium"
    profile = folder / "chromium"
    with (folder / "chromium.log").open("wb") as log:
        process = subprocess.Popen(
            [
                program, "--headless=new", "--no-sandbox", "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
                f"--user-data-dir={profile}", f"--window-size={width},{height}",
                "--no-first-run", "--disable-background-networking", "--disable-component-update",
                "--disable-sync", "--disable-extensions", "about:blank",
            ],
            stdout=log, stderr=log,
        )  # fmt: skip
    try:
        told = profile / "DevToolsActivePort"
        deadline = time.monotonic() + PATIENCE_S
        while not (told.exists() and told.read_text().count("\n")):
            assert process.poll() is None, (folder / "chromium.log").read_text()
            assert time.monotonic() < deadline, "chromium did not start"
            time.sleep(LOOK_S)
        port, path = told.read_text().splitlines()[:2]
        with connect(f"ws://127.0.0.1:{port}{path}", max_size=None) as pipe:
            pipe.send(json.dumps({"id": 0, "method": "Target.getTargets"}))
            targets = json.loads(pipe.recv(timeout=PATIENCE_S))["result"]["targetInfos"]
            page = next(each["targetId"] for each in targets if each["type"] == "page")
        with connect(f"ws://127.0.0.1:{port}/devtools/page/{page}", max_size=None) as pipe:
            yield Browser(pipe)
    finally:
        process.terminate()
        process.wait()
