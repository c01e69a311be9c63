"""The answer of a run, of any estimator: one value that terminal, report and summary.json share.

Its fields are those of summary.json. Units stand in the names or beside the numbers; a number that
does not exist is null.
"""

from enum import StrEnum

from pydantic import Field

from pcnav.config.table import Table


class Verdict(StrEnum):
    """Where a number comes from."""

    DATA = "known from data"
    PRIOR = "from prior"
    NOT = "not known"


class RunState(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    INTERRUPTED = "interrupted"


class Finding(Table):
    """One quantity of the final estimate."""

    title: str = Field(description="What it is, in words.")
    frame: str = Field(description="Axes, and for a position the two points, that it is given in.")
    unit: str = Field(description="Of `value`: m, m/s, deg/s, or 1 for what has none.")
    components: tuple[str, ...] = Field(description="Names of the numbers in `value`.")
    value: tuple[float, ...] = Field(description="In `unit`.")
    sd_unit: str = Field(description="Of `sd`: deg for attitudes and directions, else `unit`.")
    sd: tuple[float, ...] | None = Field(
        description="Stated standard deviations: one a component; of an attitude about the body's "
        "x, y and z; of a direction one, that along which it is known least. null where the "
        "estimator states none."
    )
    verdicts: tuple[Verdict, ...] = Field(
        description="One for each of `sd`, or one for all: `known from data`; `from prior`, where "
        "the data added little; `not known`, where the deviation says nothing or nothing is "
        "claimed."
    )

    budget: dict[str, tuple[float, ...]] | None = Field(
        default=None,
        description="What `sd` is made of: standard deviations, as many, by what makes them; their "
        "squares add up. null where the estimator does not say.",
    )

    @property
    def verdict(self) -> Verdict:
        """The worst of its verdicts."""
        return max(self.verdicts, key=list(Verdict).index)


class FinalEstimate(Table):
    """The last estimate that the run stands for; else the last that it has."""

    frame: int = Field(description="Index of its frame, from 0.")
    time_s: float = Field(description="Its time, as in states.csv.")
    age_s: float = Field(description="By how much the last frame of the run is later.")
    status: str = Field(description="Of that frame, as in states.csv.")
    is_claimed: bool = Field(description="Whether the run stands for it: locked or ambiguous.")
    motion: str | None = Field(
        description="As what the target is followed: torque_free or kinematic; null of estimators "
        "that know one kind."
    )
    T_cam_target: tuple[tuple[float, float, float, float], ...] | None = Field(
        description="(4, 4) pose in the camera (x right, y down, z forward; m): of the model frame "
        "where there is a mesh, else of the body axes at the mass centre. null without a pose."
    )
    findings: dict[str, Finding] = Field(description="By a name that carries the unit.")


class Answer(Table):
    """What a run found: the whole of summary.json."""

    format: int = Field(default=1, description="Of this file; raised when a field changes.")
    pcnav: str = Field(description="Version that wrote it.")
    state: RunState = Field(description="finished, or interrupted before the last frame.")
    found: bool = Field(description="Whether an estimate was claimed in any frame.")
    estimate: FinalEstimate | None = Field(description="null where there is none at all.")
    frames: int = Field(description="Frames that were looked at.")
    frames_claimed: int = Field(description="Of these, with an estimate the run stands for.")
    duration_s: float = Field(description="From the first of them to the last.")
    status_share: dict[str, float] = Field(description="Share of the frames by status.")
    nis_per_dof: float | None = Field(
        description="Mean normalised innovation squared per degree of freedom: 1 where the stated "
        "noise is right. null without innovations."
    )
    nis_bounds: tuple[float, float] | None = Field(description="95 % bounds of it.")
    warnings: tuple[str, ...] = Field(description="What is to be doubted, with the evidence.")
    recording: str = Field(description="Name of the recording.")
    estimator: str = Field(description="Key of the estimator.")
    target: str | None = Field(description="Name of the mesh; null without one.")
    symmetry: str = Field(description="Of the target: its group; C1 is none.")
    mesh_scale: float = Field(description="By which the target was found larger than its mesh.")
    mean_motion_rad_s: float | None = Field(
        description="Of the chaser's circular orbit, 0 in a laboratory; null where there is none."
    )
