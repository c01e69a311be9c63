"""Connected parts of small images, against parts found pixel by pixel."""

import numpy as np

from pcnav.perception.image_parts import bounding_box, connected_parts, mask_of, parts_of


def test_parts_are_those_found_by_walking_from_pixel_to_pixel() -> None:
    rng = np.random.default_rng(3)
    mask = rng.random((23, 31)) < 0.6
    right = mask[:, :-1] & mask[:, 1:] & (rng.random((23, 30)) < 0.8)
    down = mask[:-1] & mask[1:] & (rng.random((22, 31)) < 0.8)
    parent = {(int(v), int(u)): (int(v), int(u)) for v, u in np.argwhere(mask)}

    def root(pixel: tuple[int, int]) -> tuple[int, int]:
        while parent[pixel] != pixel:
            pixel = parent[pixel]
        return pixel

    for v, u in np.argwhere(right).tolist():
        parent[root((v, u))] = root((v, u + 1))
    for v, u in np.argwhere(down).tolist():
        parent[root((v, u))] = root((v + 1, u))
    walked: dict[tuple[int, int], set[tuple[int, int]]] = {}
    for pixel in parent:
        walked.setdefault(root(pixel), set()).add(pixel)
    expected = {frozenset(part) for part in walked.values() if len(part) >= 4}
    found = parts_of(connected_parts(mask, right, down), 4)
    assert {frozenset(zip(v.tolist(), u.tolist(), strict=True)) for v, u in found} == expected
    for rows, columns in found:
        pixels = rows * 31 + columns
        assert np.all(np.diff(pixels) > 0)
        assert np.array_equal(np.flatnonzero(mask_of(pixels, mask.shape)), pixels)


def test_the_box_about_a_mask_holds_it_tightly() -> None:
    mask = np.zeros((9, 12), dtype=np.bool_)
    assert mask[bounding_box(mask)].size == 0
    mask[[2, 6], [5, 3]] = True
    assert bounding_box(mask) == (slice(2, 7), slice(3, 6))
