"""Frames per second of the whole `pcnav run`, by stage."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from rich.table import Table

from benchmarks.scenes import Scene
from benchmarks.stopwatch import Stopwatch
from pcnav.pipeline import run

_READING = "waiting for depth images"
_PERCEPTION = "perception of the frame"
_ACQUISITION = "acquisition (first frames)"
_COMPARISON = "comparison with the rendered view"
_ARC = "arc fits"
_FILTER = "association and filter"
_WRITING = "writing results"
_REPORT = "evaluation and report (once)"
_OTHER = "other"
PER_FRAME = (
    _READING,
    _PERCEPTION,
    _ACQUISITION,
    _COMPARISON,
    _ARC,
    _FILTER,
    _WRITING,
    _OTHER,
)

_PLACES = {
    "pcnav.pipeline.open_recording": _READING,
    # They are read in a thread beside; this is what the run waits for it.
    "concurrent.futures.Future.result": _READING,
    "pcnav.perception.reading.perceive": _PERCEPTION,
    "pcnav.perception.reading.pose_hypotheses": _ACQUISITION,
    "pcnav.perception.render_compare.RenderComparer.compare": _COMPARISON,
    "pcnav.estimators.depth.initial_arc.fit_arc": _ARC,
    "pcnav.estimators.depth.tracker.Tracker.step": _FILTER,
    "pcnav.runs.writer.RunWriter.add": _WRITING,
    "pcnav.runs.writer.RunWriter.finish_tables": _WRITING,
    "pcnav.navigation.read_run": _REPORT,
    "pcnav.navigation.truth_of": _REPORT,
    "pcnav.navigation.evaluate": _REPORT,
    "pcnav.navigation.gain_of_run": _REPORT,
    "pcnav.report.overlay.frame_picture": _REPORT,
    "pcnav.navigation.tables_of_run": _REPORT,
    "pcnav.navigation.library_versions": _REPORT,
    "pcnav.report.run_report.write_report": _REPORT,
}


@dataclass(frozen=True)
class Throughput:
    """What one run took."""

    frames: int
    seconds: dict[str, float]
    """By stage."""

    @property
    def frames_per_second(self) -> float:
        """Reading and writing included, evaluation and report not."""
        return self.frames / sum(self.seconds.get(stage, 0.0) for stage in PER_FRAME)

    @property
    def numbers(self) -> dict[str, float]:
        """By name, for a history."""
        per_frame = {f"{stage}, ms a frame": self.seconds.get(stage, 0.0) for stage in PER_FRAME}
        report = {f"{_REPORT}, s": self.seconds.get(_REPORT, 0.0)}
        return {name: 1e3 * s / self.frames for name, s in per_frame.items()} | report


def measure_throughput(scene: Scene, out: Path) -> Throughput:
    """Run the pipeline once from disk to a result folder, imports already done."""
    watch = Stopwatch()
    with watch.watching(_PLACES):
        start = perf_counter()
        run(scene.path, out, scene.pipeline)
        total = perf_counter() - start
    seconds = dict(watch.seconds)
    seconds[_OTHER] = total - sum(seconds.values())
    return Throughput(scene.pipeline.scenario.frames, seconds)


def throughput_table(scene: Scene, throughput: Throughput) -> Table:
    """Stages in the order of the data flow."""
    size = f"{scene.pipeline.camera.width_px} x {scene.pipeline.camera.height_px} px"
    table = Table(
        title=f"pcnav run: {scene.name}, {throughput.frames} frames of {size}",
        caption="Wall-clock time from PNG files to the result folder; imports are not counted.",
    )
    table.add_column("stage")
    table.add_column("s", justify="right")
    table.add_column("ms a frame", justify="right")
    table.add_column("share", justify="right")
    running = throughput.frames / throughput.frames_per_second
    for stage in PER_FRAME:
        seconds = throughput.seconds.get(stage, 0.0)
        per_frame = f"{1e3 * seconds / throughput.frames:.2f}"
        table.add_row(stage, f"{seconds:.2f}", per_frame, f"{seconds / running:.0%}")
    per_frame = f"{1e3 * running / throughput.frames:.2f}"
    rate = f"all of a frame: {throughput.frames_per_second:.1f} frames/s"
    table.add_row(rate, f"{running:.2f}", per_frame, "100%", style="bold", end_section=True)
    table.add_row(_REPORT, f"{throughput.seconds.get(_REPORT, 0.0):.2f}", "", "")
    return table
