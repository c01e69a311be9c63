"""What a grid calls the estimators; nothing heavy is imported to know that."""

from enum import StrEnum


class EstimatorName(StrEnum):
    """Everything that can be put to the test.

    One list holds pcnav's modes and its peers: every name is a whole method, so no combination of
    settings can be asked for that does not exist.
    """

    PCNAV = "pcnav"
    """The tracker on range residuals and outline, as `pcnav run` does by default."""
    PCNAV_RECTANGLES = "pcnav_rectangles"
    """The tracker on recognised rectangles, area-weighted."""
    PCNAV_BOTH = "pcnav_both"
    """As pcnav, with rectangles searched for in every frame as a check."""
    PCNAV_PAPER = "pcnav_paper"
    """The tracker on recognised rectangles with the plain means of Yu 2019."""
    PCNAV_SINGLE_FRAME = "pcnav_single_frame"
    """Every frame on its own, without prediction or memory."""
    OPEN3D_ICP = "open3d_icp"
    """Open3D's point-to-plane ICP."""
    OPEN3D_ICP_TUKEY = "open3d_icp_tukey"
    """The same with Tukey's weights."""
    SMALL_GICP = "small_gicp"
    """small_gicp's GICP."""
    SMALL_GICP_10 = "small_gicp_10"
    """The same with covariances of 10 neighbours instead of 20."""
    KISS_ICP = "kiss_icp"
    """KISS-ICP odometry, which has no model."""
