"""Layouts name every row of an error state once."""

import numpy as np
import pytest

from pcnav.dynamics import state
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    FILE_ORDER,
    MASS_CENTRE_LAYOUT,
    MOTION_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    ROTATION_LAYOUT,
    VELOCITY,
    Layout,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.truth import STATE_COLUMNS


def test_the_layout_of_the_depth_filter_is_that_of_its_state() -> None:
    slices = [MASS_CENTRE_LAYOUT.slice_of(block) for block in MASS_CENTRE_LAYOUT.blocks]
    assert slices == [
        *(state.R_HILL, state.V_HILL, state.COM_MODEL),
        *(state.THETA_BODY, state.OMEGA_BODY, state.INERTIA_RATIOS),
    ]
    assert MASS_CENTRE_LAYOUT.size == state.STATE_SIZE


def test_columns_are_those_of_the_files() -> None:
    assert ("time_s", *MASS_CENTRE_LAYOUT.columns) == STATE_COLUMNS
    assert MOTION_LAYOUT.size == 17
    assert ROTATION_LAYOUT.size == 11
    assert Layout((RATIOS, ATTITUDE)).sd_columns[:3] == ATTITUDE.sd_columns


@pytest.mark.parametrize("layout", [MASS_CENTRE_LAYOUT, MOTION_LAYOUT, ROTATION_LAYOUT])
def test_every_row_of_an_error_state_has_one_block(layout: Layout) -> None:
    rows = np.concatenate([np.arange(layout.size)[layout.slice_of(b)] for b in layout.blocks])
    assert np.array_equal(np.sort(rows), np.arange(layout.size))
    assert len(set(layout.sd_columns)) == layout.size


def test_a_layout_does_not_know_the_rows_of_what_it_lacks() -> None:
    assert CENTRE not in MOTION_LAYOUT
    with pytest.raises(KeyError):
        MOTION_LAYOUT.slice_of(CENTRE)
    assert {POSITION, VELOCITY, RATE} < set(FILE_ORDER)


def test_frames_without_a_value_have_no_estimate() -> None:
    some = np.array([np.nan, 1.0, np.nan])
    values = {block.name: np.tile(some[:, None], block.size) for block in (RATE, RATIOS)}
    values[ATTITUDE.name] = np.tile(some[:, None, None], (3, 3))
    found = Trajectory(np.arange(3.0), ROTATION_LAYOUT, values, sd=np.ones((3, 11)))
    assert found.has_estimate.tolist() == [False, True, False]
    assert np.isnan(found.sd_of(CENTRE)).all()
    assert found.at(slice(1, None)).has_estimate.tolist() == [True, False]
