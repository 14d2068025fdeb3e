"""A browser for the tests of pages: Debian's Chromium through playwright; without Chromium the tests are skipped."""

import contextlib
import os
import shutil
import time

import pytest

FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip
#: messages of the software renderer, not of the page
RENDERER = ("GPU stall due to ReadPixels", "willReadFrequently", "GL Driver Message")
PATIENCE = 120_000  # [ms]; a busy machine reads five megabytes of script slowly


@contextlib.contextmanager
def started_browser():
    """Yield Chromium; skip the test where Chromium or playwright is missing."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")
    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if not path:
        pytest.skip("needs a Chromium (Debian: apt-get install chromium), or its path in the variable CHROMIUM")
    with playwright.sync_playwright() as play:
        running = play.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield running
        finally:
            running.close()


class Visit:
    """One page in a separate context, with its console messages and its requests."""

    def __init__(self, running, url: str, width: int = 1400, dark: bool = False, touch: bool = False):
        scheme = "dark" if dark else "light"
        self.context = running.new_context(
            viewport={"width": width, "height": 900}, color_scheme=scheme, has_touch=touch, reduced_motion="reduce"
        )
        self.page = self.context.new_page()
        self.console, self.requests = [], []
        self.page.on("console", lambda m: self.console.append(f"{m.type}: {m.text}"))
        self.page.on("pageerror", lambda e: self.console.append(f"error: {e}"))
        self.page.on("request", lambda r: self.requests.append(r.url))
        self.page.set_default_timeout(PATIENCE)
        self.page.goto(url)
        self.page.wait_for_function("document.documentElement.dataset.ready === 'yes'")

    def ask(self, script: str, argument=None):
        return self.page.evaluate(script, argument)

    @property
    def complaints(self) -> list[str]:
        return [text for text in self.console if not any(known in text for known in RENDERER)]

    def settled_overhang(self, seconds: float = 20.0) -> float:
        """[px] The width beyond the screen of the widest element that does not scroll by itself.

        A busy machine takes long to draw every picture again.
        """
        script = """() => {
          const wide = document.documentElement.clientWidth;
          const over = [...document.querySelectorAll("body *")]
            .filter((e) => !e.closest(".wide, .js-plotly-plot, #source"))
            .map((e) => e.getBoundingClientRect().right - wide);
          return Math.max(document.documentElement.scrollWidth - wide, ...over);
        }"""
        end = time.monotonic() + seconds
        while (overhang := self.ask(script)) > 0.5 and time.monotonic() < end:
            self.page.wait_for_timeout(50)
        return overhang

    def close(self) -> None:
        self.context.close()
