"""A headless Chromium, driven through its DevTools protocol over a pipe; the standard library alone.

    with Browser(find()) as browser:
        page = browser.open("report.html")
        page.evaluate("document.title")
"""
import base64
import fcntl
import json
import os
import pathlib
import select
import shutil
import signal
import struct
import tempfile
import time
import zlib

TIMEOUT = 60  # seconds for any one answer, on a slow and busy machine


def find():
    """The browser's path, or None."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-headless-shell"))), None)


class Browser:
    def __init__(self, program):
        self.folder = tempfile.TemporaryDirectory(prefix="mtsm-browser-")
        self.log = pathlib.Path(self.folder.name, "stderr")
        command_read, self.command = os.pipe()
        self.answer, answer_write = os.pipe()
        # It reads commands from descriptor 3 and answers on 4; both may be taken here.
        far = [fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 10) for fd in (command_read, answer_write)]
        arguments = [program, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                     "--remote-debugging-pipe", "--enable-logging=stderr", "--force-color-profile=srgb",
                     "--disable-background-networking", "--disable-component-update", "--no-first-run",
                     f"--user-data-dir={self.folder.name}/profile"]
        environment = {**os.environ, "HOME": self.folder.name}
        self.process = os.posix_spawn(program, arguments, environment, setpgroup=0, file_actions=[
            (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
            (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
            (os.POSIX_SPAWN_OPEN, 2, str(self.log), os.O_WRONLY | os.O_CREAT, 0o600),
            (os.POSIX_SPAWN_DUP2, far[0], 3), (os.POSIX_SPAWN_DUP2, far[1], 4)])
        for fd in (command_read, answer_write, *far):
            os.close(fd)
        self.last = 0
        self.pending = b""
        self.events = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.call("Browser.close")
            deadline = time.monotonic() + 10
            while time.monotonic() < deadline and os.waitpid(self.process, os.WNOHANG)[0] == 0:
                time.sleep(0.05)
        except (OSError, RuntimeError):
            pass
        for end in (lambda: os.killpg(self.process, signal.SIGKILL), lambda: os.waitpid(self.process, 0)):
            try:
                end()
            except OSError:
                pass  # it has ended already
        os.close(self.command)
        os.close(self.answer)
        self.folder.cleanup()

    def receive(self):
        deadline = time.monotonic() + TIMEOUT
        while b"\0" not in self.pending:
            ready, _, _ = select.select([self.answer], [], [], max(0, deadline - time.monotonic()))
            piece = os.read(self.answer, 1 << 20) if ready else b""
            if not piece:
                raise RuntimeError("the browser does not answer:\n" + self.log.read_text(errors="replace"))
            self.pending += piece
        message, self.pending = self.pending.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, session=None, **parameters):
        self.last += 1
        message = {"id": self.last, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.command, data):]
        while True:
            answer = self.receive()
            if answer.get("id") == self.last:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def open(self, path, width=1280, height=900, dark=False):
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, session)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.call(domain + ".enable")
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1,
                  mobile=False)
        page.call("Emulation.setEmulatedMedia", features=[
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])
        page.call("Page.navigate", url=pathlib.Path(path).resolve().as_uri())
        deadline = time.monotonic() + TIMEOUT
        while not page.evaluate("document.readyState === 'complete' && location.protocol === 'file:'"):
            if time.monotonic() > deadline:
                raise RuntimeError(f"{path} does not load")
            time.sleep(0.02)
        return page


class Page:
    def __init__(self, browser, session):
        self.browser, self.session = browser, session

    def call(self, method, **parameters):
        return self.browser.call(method, self.session, **parameters)

    def evaluate(self, expression):
        """The value of a JavaScript expression; a promise's is waited for."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def complaints(self):
        """Errors of scripts, of the console and of the log, dialogs, requests for what is not in the page."""
        found = []
        for event in self.browser.events:
            name, p = event.get("method"), event.get("params", {})
            if event.get("sessionId") != self.session:
                continue
            if name in ("Runtime.exceptionThrown", "Page.javascriptDialogOpening"):
                found.append(json.dumps(p))
            elif name == "Runtime.consoleAPICalled" and p["type"] in ("error", "assert", "warning"):
                found.append(json.dumps(p["args"]))
            elif name == "Log.entryAdded" and p["entry"]["level"] in ("error", "warning"):
                found.append(p["entry"]["text"])
            elif name == "Network.requestWillBeSent" and not p["request"]["url"].startswith(("data:", "file:///")):
                found.append("a request for " + p["request"]["url"])
        return found

    def settle(self):
        """Until what was asked for is drawn."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(0))))")

    def box(self, selector):
        """Left, top, width and height in the window, scrolled into view."""
        element = f"document.querySelector({json.dumps(selector)})"
        self.evaluate(element + ".scrollIntoView({block: 'center'})")
        self.settle()
        return self.evaluate(f"(({{left, top, width, height}}) => [left, top, width, height])("
                             f"{element}.getBoundingClientRect())")

    def mouse(self, kind, x, y, pressed=False):
        held = pressed or kind != "mouseMoved"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left" if held else "none",
                  buttons=1 if pressed else 0, clickCount=0 if kind == "mouseMoved" else 1)

    def drag(self, start, end):
        self.mouse("mousePressed", *start, pressed=True)
        for i in range(1, 5):
            self.mouse("mouseMoved", *(a + (b - a) * i / 4 for a, b in zip(start, end)), pressed=True)
        self.mouse("mouseReleased", *end)
        self.settle()

    def click(self, selector):
        left, top, width, height = self.box(selector)
        self.drag((left + width / 2, top + height / 2), (left + width / 2, top + height / 2))

    def key(self, key):
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)
        self.settle()

    def choose(self, selector, value):
        """As a person chooses from a list: the value, then the event that it brings."""
        self.evaluate(f"(() => {{ const s = document.querySelector({json.dumps(selector)});"
                      f"s.value = {json.dumps(str(value))};"
                      "s.dispatchEvent(new Event('change', {bubbles: true})); })()")
        self.settle()

    def screenshot(self, clip):
        """A PNG of left, top, width and height of the page."""
        clip = {**dict(zip(("x", "y", "width", "height"), clip)), "scale": 1}
        return base64.b64decode(self.call("Page.captureScreenshot", format="png", clip=clip)["data"])

    def pixel(self, x, y):
        """Red, green and blue at a place of the window."""
        scroll = self.evaluate("[scrollX, scrollY]")
        data = self.screenshot((x + scroll[0], y + scroll[1], 1, 1))
        at, packed = 8, b""
        while at < len(data):
            length, kind = struct.unpack_from(">I4s", data, at)
            packed += data[at + 8:at + 8 + length] if kind == b"IDAT" else b""
            at += length + 12
        return tuple(zlib.decompress(packed)[1:4])  # one pixel: no filter changes it
