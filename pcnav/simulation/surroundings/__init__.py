"""What a simulated depth frame shows beside the target: backgrounds, occluders, and their poses."""
