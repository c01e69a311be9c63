"""Yu, Zhao and Zhang 2019: pose of malfunctioned satellites from depth information."""
