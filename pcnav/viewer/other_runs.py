"""Runs on feature tracks and on images of one camera, told as a story."""

from pcnav.viewer.story import RunKind

OTHER_KINDS: tuple[RunKind, ...] = ()
