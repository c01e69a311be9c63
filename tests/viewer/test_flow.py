"""A browser is sent no more than it takes, and enough to draw a new frame each time."""

import threading
import time

import pytest

from pcnav.viewer.clock import frame_to_show
from pcnav.viewer.flow import Flow


class Page:
    """Answers as many questions as it is let."""

    def __init__(self) -> None:
        self.let, self.asked = threading.Semaphore(0), 0

    def ask(self) -> bool:
        self.asked += 1
        return self.let.acquire(timeout=20.0)


@pytest.mark.parametrize(("plays", "on_the_way"), [(True, 3), (False, 1)])
def test_so_many_frames_are_on_their_way_and_no_more(plays: bool, on_the_way: int) -> None:
    page = Page()
    flow, drawn = Flow(page.ask), []

    def draw() -> None:
        for k in range(6):
            flow.wait(lambda: False, plays=plays)
            drawn.append(k)
            flow.sent()

    thread = threading.Thread(target=draw)
    thread.start()
    for taken in range(4):
        deadline = time.monotonic() + 10.0
        while len(drawn) < on_the_way + taken and time.monotonic() < deadline:
            time.sleep(0.002)
        time.sleep(0.05)
        assert len(drawn) == min(on_the_way + taken, 6)
        page.let.release()
    for _ in range(6):
        page.let.release()
    thread.join(10.0)
    assert drawn == list(range(6))
    flow.close()


def test_a_page_that_does_not_answer_is_asked_again_and_one_that_left_holds_nobody() -> None:
    answers, closed = [False, False, True], threading.Event()
    flow = Flow(lambda: answers.pop(0))
    flow.sent()
    flow.wait(closed.is_set, plays=False)
    assert answers == []
    silent = Flow(lambda: closed.set() or False)  # type: ignore[func-returns-value]
    silent.sent()
    silent.wait(closed.is_set, plays=False)
    flow.close()
    silent.close()
    # Of a program that ends: no exception.
    flow.sent()


@pytest.mark.parametrize(
    ("due", "shown", "prepared", "drawn"),
    [
        (5, 4, None, 5),
        (5, 4, 5, 5),
        # As late as the frame is on from the one before, or one early.
        (9, 4, 7, 7),
        (10, 4, 7, 7),
        (11, 4, 7, 11),
        (6, 4, 7, 7),
        (5, 4, 7, 5),
        # It was drawn early: the next is not due yet.
        (6, 7, 10, 7),
        # Begun anew.
        (0, 59, 62, 0),
    ],
)
def test_what_was_prepared_is_drawn_when_it_is_about_due(
    due: int, shown: int, prepared: int | None, drawn: int
) -> None:
    assert frame_to_show(due, shown, prepared) == drawn
