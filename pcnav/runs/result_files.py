"""Names of the files of a result folder, and of the columns that are told nowhere else."""

STATES_FILE = "states.csv"
POSES_FILE = "poses.tum"
COVARIANCES_FILE = "covariances.npz"
RAW_COVARIANCES_FILE = "covariances.partial"
"""There while the run goes on, and after one that was killed."""
MEASUREMENTS_FILE = "measurements.csv"
FEATURES_FILE = "features.csv"
POINTS_FILE = "points.csv"
FEATURE_OUTCOMES_FILE = "feature_outcomes.csv"
SEGMENTS_FILE = "segments.csv"
SUMMARY_FILE = "summary.json"
"""What the run found; always there, see `pcnav.evaluation.answer.model`."""
METRICS_FILE = "metrics.json"
KNOWLEDGE_FILE = "knowledge.csv"
MESH_FIT_FILE = "mesh_fit.csv"
REPORT_FILE = "report.html"
SKIPPED_FRAMES_FILE = "skipped_frames.csv"
"""Depth frames that could not be read, where there were any."""
PIPELINE_FILE = "pipeline.toml"
TIMING_FILE = "timing.csv"
"""When frames that were followed as they arrived were answered."""
RESULT_FILES = (
    *(STATES_FILE, POSES_FILE, COVARIANCES_FILE, RAW_COVARIANCES_FILE, MEASUREMENTS_FILE),
    *(FEATURES_FILE, POINTS_FILE, FEATURE_OUTCOMES_FILE, SEGMENTS_FILE, SUMMARY_FILE),
    *(METRICS_FILE, KNOWLEDGE_FILE),
    *(MESH_FIT_FILE, REPORT_FILE, SKIPPED_FRAMES_FILE, PIPELINE_FILE, TIMING_FILE),
)
"""All that a result folder may hold."""

FEATURE_COLUMNS = (
    *("feature", "x_m", "y_m", "z_m", "sd_x_m", "sd_y_m", "sd_z_m"),
    *("frames_seen", "frames_rejected"),
)
POINT_COLUMNS = ("time_s", "feature", "x_m", "y_m", "z_m")
SEGMENT_COLUMNS = ("time_s", "q_x", "q_y", "q_z", "q_w")
"""The attitude is R_world_body, scalar last."""
