"""Results as tables and arrays. Needs a result folder run."""

import numpy as np
import pandas as pd

import pcnav
from pcnav.dynamics.blocks import CENTRE, RATE

states = pd.read_csv("run/states.csv", index_col="time_s")  # one row a frame, SI and rad
print(states.groupby("status").size())
print(states[["w_x_rad_s", "w_y_rad_s", "w_z_rad_s", "sd_w_x_rad_s"]].tail(3))

run = pcnav.read_run("run", with_covariance=True)
print(run)
claimed = np.isin(run.status, ("locked", "ambiguous"))
poses = run.trajectory.poses[claimed]  # (n, 4, 4) T_cam_model
print("last pose", poses[-1], "mass centre", run.trajectory[CENTRE][-1], "m")
print("its covariance", run.trajectory.covariance_of(CENTRE)[-1])
print("rate", np.degrees(run.trajectory[RATE][-1]), "deg/s")
