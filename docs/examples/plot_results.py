"""The rate with its 3 sigma band. Needs a result folder run."""

import matplotlib.pyplot as plt
import numpy as np

import pcnav
from pcnav.dynamics.blocks import RATE

run = pcnav.read_run("run")
rate, sd = np.degrees(run.trajectory[RATE]), np.degrees(run.trajectory.sd_of(RATE))
figure, axes = plt.subplots()
for k, name in enumerate("xyz"):
    axes.plot(run.time_s, rate[:, k], label=name)
    axes.fill_between(run.time_s, rate[:, k] - 3 * sd[:, k], rate[:, k] + 3 * sd[:, k], alpha=0.2)
axes.set(xlabel="time, s", ylabel="rate, deg/s", title=run.name)
axes.legend()
figure.savefig("rate.png")
