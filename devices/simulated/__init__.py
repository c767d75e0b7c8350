"""Two simulated Kinects in front of one person whose joints are known exactly."""
