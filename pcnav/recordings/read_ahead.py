"""The frames of a recording, each read while the one before it is worked on."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

from pcnav.recordings.depth_image import read_depth_image
from pcnav.recordings.sequence import Frame, Sequence

Read = Callable[[int], Frame]


@contextmanager
def read_ahead(sequence: Sequence) -> Iterator[Read]:
    """Reads frames as `Sequence.frame` does, and one frame beyond, in a thread beside.

    The frames are the same, in the order they are asked for, and the fault of a frame is raised
    where it is asked for. Only images that are PNG files of their own are read so: what reads
    other formats keeps files open, or the warnings of the process, that belong to one thread.
    """
    alone = sequence.read_scan is None and sequence.read_image is read_depth_image
    if not alone or not all(name.lower().endswith(".png") for name in sequence.files):
        yield sequence.frame
        return
    coming: dict[int, Future[Frame]] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="frames") as thread:

        def frame(index: int) -> Frame:
            now = coming.pop(index, None) or thread.submit(sequence.frame, index)
            coming.clear()
            if index + 1 < len(sequence):
                coming[index + 1] = thread.submit(sequence.frame, index + 1)
            return now.result()

        yield frame
