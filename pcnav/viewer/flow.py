"""How fast a browser takes what is drawn for it: neither more than it shows, nor less."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress

_MAX_ON_THE_WAY = 3
"""Frames at a time of a run that is played. With one alone the browser draws it twice or more while
the next is on its way; more than three gain nothing."""


class Flow:
    """What is on its way to one browser.

    ``ask`` waits until the page has worked off all that was drawn before it was called, and tells
    whether it did so in time.
    """

    def __init__(self, ask: Callable[[], bool]) -> None:
        self._ask = ask
        self._threads = ThreadPoolExecutor(_MAX_ON_THE_WAY, "pcnav questions")
        self._asked: deque[Future[bool]] = deque()

    def sent(self) -> None:
        """Something was drawn."""
        # When the program ends, its threads take no more work while others still run.
        with suppress(RuntimeError):
            self._asked.append(self._threads.submit(self._ask))

    def wait(self, is_closed: Callable[[], bool], *, plays: bool) -> None:
        """Until the next frame may be drawn: at rest, when the page has worked off the last one;
        what it is asked for then is the newest. A slow browser holds up its own thread alone."""
        most = _MAX_ON_THE_WAY if plays else 1
        while not is_closed() and len(self._asked) >= most:
            if not self._asked.popleft().result():
                self.sent()

    def close(self) -> None:
        """Ask no more."""
        self._threads.shutdown(wait=False, cancel_futures=True)
